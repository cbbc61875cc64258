"""The paper's ablations: Tables 2 to 4 on any labelled log."""
