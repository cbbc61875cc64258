"""The paper's mapper: one frame after the other into a neural field."""
