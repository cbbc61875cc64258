"""Asking a map: surfaces, objects, texts and pictures, relations (paper, Sec. 5.3)."""
