"""The neural field: encodings, decoders, heads, rendering and losses (paper, Sec. 4)."""
