"""Classical filters: samples of the IMU go in, roll and pitch come out; one file each, batch-first."""
