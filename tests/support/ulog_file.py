"""ULog files of a few topics: pyulog reads them and writes none from arrays."""

from pathlib import Path

import numpy as np


def write_ulog(path: Path, topics: dict[str, tuple[str, np.ndarray, np.ndarray]]) -> None:
    """A minimal ULog file: definitions, one subscription a topic, then all samples in order of time.

    Args:
        path: The file.
        topics: Name to the definition of its fields, stamps (T,) [us] and values of the other fields (T, k).
    """

    def message(kind: str, content: bytes) -> bytes:
        return len(content).to_bytes(2, "little") + kind.encode() + content

    out = [b"ULog\x01\x12\x35\x01" + (0).to_bytes(8, "little"), message("B", bytes(40))]
    out += [message("F", f"{name}:{fields}".encode()) for name, (fields, _, _) in topics.items()]
    out += [message("A", bytes([0, k, 0]) + name.encode()) for k, name in enumerate(topics)]
    samples = [
        (int(stamp), k, values.astype("<f4").tobytes())
        for k, (_, stamps, rows) in enumerate(topics.values())
        for stamp, values in zip(stamps, rows, strict=True)
    ]
    out += [
        message("D", bytes([k, 0]) + s.to_bytes(8, "little") + values) for s, k, values in sorted(samples)
    ]
    path.write_bytes(b"".join(out))
