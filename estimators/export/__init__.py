"""Export: a weights file goes in; C99, a NIR graph or an ONNX graph comes out."""
