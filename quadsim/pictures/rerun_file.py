"""A flight as a recording of rerun (.rrd), with a layout of its views."""

from pathlib import Path

import numpy as np

from .timeline import BODY, COLOURS, Array, Timeline, outline

WIND_SCALE = 0.06
"""Length of the wind's arrow, metres for each m/s."""


def write(path: Path, timeline: Timeline) -> None:
    """Write a recording; its timeline `time` begins at 0 s.

    Args:
        path: File to write, `.rrd`.
        timeline: What it shows.
    """
    import rerun as rr  # pyright: ignore[reportMissingImports]
    import rerun.blueprint as rrb  # pyright: ignore[reportMissingImports]

    recording = rr.RecordingStream("quadsim")
    recording.save(path)

    def at(time: Array) -> list[rr.TimeColumn]:
        return [rr.TimeColumn("time", duration=time)]

    def static(*entity: str, of: rr.AsComponents) -> str:
        recording.log(place := rr.new_entity_path(list(entity)), of, static=True)
        return place

    static("world", of=rr.ViewCoordinates.RIGHT_HAND_Z_UP)
    time, position, shape = timeline.time, timeline.position, outline(timeline.vehicle)
    static("world", "path", of=rr.LineStrips3D([position], colors=(*COLOURS["true"], 90)))
    for name, quat in timeline.poses.items():
        known = np.isfinite(np.hstack([quat, position])).all(axis=1)
        poses = rr.Transform3D.columns(translation=position[known], quaternion=quat[known][:, [1, 2, 3, 0]])
        recording.send_columns(rr.new_entity_path(["world", name]), at(time[known]), poses)
        colour = COLOURS["true" if name == BODY else "estimate"]
        static("world", name, "outline", of=rr.LineStrips3D(shape, colors=colour, radii=0.004))
    if timeline.target is not None:
        place = static("world", "target", of=rr.Points3D.from_fields(colors=COLOURS["target"], radii=0.03))
        recording.send_columns(place, at(time), rr.Points3D.columns(positions=timeline.target))
    if timeline.wind is not None:
        place = static("world", "wind", of=rr.Arrows3D.from_fields(colors=COLOURS["wind"], radii=0.008))
        arrows = rr.Arrows3D.columns(vectors=WIND_SCALE * timeline.wind, origins=position)
        recording.send_columns(place, at(time), arrows)
    views = []
    for name, trace in timeline.traces.items():
        place = static("traces", name, of=rr.SeriesLines(names=list(trace.curves)))
        values = np.stack(list(trace.curves.values()), axis=1)
        recording.send_columns(place, at(time), rr.Scalars.columns(scalars=values))
        views.append(rrb.TimeSeriesView(origin=place, name=f"{name} [{trace.unit}]"))
    for name, spikes in timeline.spikes.items():
        place = static("spikes", name, of=rr.SeriesPoints(marker_sizes=1.0, names=name))
        steps, counts = np.unique(spikes.time, return_counts=True)
        rows = rr.Scalars.columns(scalars=spikes.neuron.astype(float)).partition(counts)
        recording.send_columns(place, at(steps), rows)
        views.append(rrb.TimeSeriesView(origin=place, name=f"spikes of {name} [neuron]"))
    scene = rrb.Spatial3DView(origin="world", name="flight")
    recording.send_blueprint(rrb.Blueprint(rrb.Horizontal(scene, rrb.Grid(*views, grid_columns=2))))
    recording.disconnect()
