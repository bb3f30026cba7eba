"""Classical filters, from IMU samples to roll and pitch; one file each, batch-first."""
