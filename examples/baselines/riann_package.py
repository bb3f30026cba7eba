"""RIANN (Weber, Gühmann & Seel 2021), a recurrent network, from the ONNX file in the package `riann`."""

from importlib.resources import files

import numpy as np
from onnxruntime import InferenceSession, SessionOptions

from quadsim.rotation import roll_pitch_from_quat


class Riann:
    """RIANN: two GRU layers of 200 units."""

    parameter_count = 367_404
    operations = 2 * 367_404  # a product and a sum for each

    def __init__(self, rate_hz):
        self.rate_hz, options = rate_hz, SessionOptions()
        options.intra_op_num_threads = 1
        self.network = InferenceSession((files("riann") / "riann.onnx").read_bytes(), options)

    def reset(self, n=1, roll_pitch=None):
        """Start n vehicles."""
        self.hidden = [np.zeros((2, 1, 1, 200), np.float32) for _ in range(n)]
        self.last = np.tile([0.0, 0.0, 9.81, 0.0, 0.0, 0.0, 1.0 / self.rate_hz], (n, 1))

    def update(self, gyro, accel):
        """Roll and pitch (n, 2) [rad]; the last good number stands in for a missing one."""
        readings = np.column_stack([accel, gyro, self.last[:, 6]])
        self.last = np.where(np.isfinite(readings), readings, self.last)
        quat = np.empty((len(self.last), 4))
        for k, row in enumerate(self.last.astype(np.float32)):
            out, self.hidden[k] = self.network.run(None, {"input": row[None, None], "h0": self.hidden[k]})
            quat[k] = out.reshape(4)
        return roll_pitch_from_quat(quat / np.linalg.norm(quat, axis=1, keepdims=True))
