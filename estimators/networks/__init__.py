"""Networks: scaled readings of the IMU go in, roll and pitch come out; weights from safetensors files."""
