"""A log under many budgets, seeds and settings, and each map judged."""
