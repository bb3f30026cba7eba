"""Networks of layers, from scaled IMU readings to roll and pitch; weights from safetensors files."""
