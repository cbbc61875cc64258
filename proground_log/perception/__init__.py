"""Prompted perception: a task and a colour image in, regions with relevance and embedding out."""
