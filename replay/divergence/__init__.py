"""Where two runs part ways: first difference, repetition, bisection."""
