"""Detector, segmenter and encoders of one's own, as ONNX files."""
