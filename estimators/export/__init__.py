"""Export of weights as C99, NIR graphs or ONNX graphs."""
