"""A flight as a recording for rerun (.rrd), with a layout of the views."""

from itertools import cycle
from pathlib import Path
from typing import Any

import numpy as np

from .timeline import BODY, COLOURS, PALETTE, Array, Timeline, outline, styles

WIND_SCALE = 0.06
"""Length of the wind's arrow, metres for each m/s."""
EYE = -1.2, -0.9, 0.6
"""Initial position of the eye relative to the vehicle [m]."""
ROWS = ("roll", "error of roll"), ("pitch", "error of pitch")
"""Traces that are shown side by side; the others are in tabs."""


def write_rerun(path: Path, timeline: Timeline) -> None:
    """Write a recording, whose timeline `time` starts at 0 s.

    Args:
        path: File to write, `.rrd`.
        timeline: The flight to show.
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
    static("world", "path", of=rr.LineStrips3D([position], colors=(*COLOURS["true"], 90), radii=0.003))
    colours = [colour for colour, _ in styles(timeline.poses, timeline.poses)]
    for (name, quat), colour in zip(timeline.poses.items(), colours, strict=True):
        known = np.isfinite(np.hstack([quat, position])).all(axis=1)
        poses = rr.Transform3D.columns(translation=position[known], quaternion=quat[known][:, [1, 2, 3, 0]])
        recording.send_columns(rr.new_entity_path(["world", name]), at(time[known]), poses)
        static("world", name, "outline", of=rr.LineStrips3D(shape, colors=colour, radii=0.004))
    if timeline.target is not None:
        place = static("world", "target", of=rr.Points3D.from_fields(colors=COLOURS["target"], radii=0.03))
        recording.send_columns(place, at(time), rr.Points3D.columns(positions=timeline.target))
    if timeline.wind is not None:
        place = static("world", "wind", of=rr.Arrows3D.from_fields(colors=COLOURS["wind"], radii=0.008))
        arrows = rr.Arrows3D.columns(vectors=WIND_SCALE * timeline.wind, origins=position)
        recording.send_columns(place, at(time), arrows)
    views = {}
    for name, trace in timeline.traces.items():
        drawn = styles(trace.curves, timeline.poses)
        colours = [(*colour, 130 if beside else 255) for colour, beside in drawn]
        lines = rr.SeriesLines(names=list(trace.curves), colors=colours, widths=1.5)
        place = static("traces", name, of=lines)
        values = np.stack(list(trace.curves.values()), axis=1)
        recording.send_columns(place, at(time), rr.Scalars.columns(scalars=values))
        legend = rrb.PlotLegend(rrb.Corner2D.LeftTop, visible=not name.startswith("error"))
        views[name] = rrb.TimeSeriesView(origin=place, name=f"{name} [{trace.unit}]", plot_legend=legend)
    first = 0
    for (name, spikes), colour in zip(timeline.spikes.items(), cycle(PALETTE)):
        below, first = first, first + int(spikes.neuron.max()) + 1
        dots = rr.SeriesPoints(marker_sizes=1.0, names=f"{name}: {below}–{first - 1}", colors=colour)
        place = static("spikes", name, of=dots)
        rows = rr.Scalars.columns(scalars=below + spikes.neuron.astype(float))
        recording.send_columns(place, at(spikes.time), rows)
    recording.send_blueprint(_layout(rr, rrb, timeline, views))
    recording.disconnect()


def _layout(rr: Any, rrb: Any, timeline: Timeline, views: dict[str, Any]) -> Any:
    """Return the layout: the vehicle beside roll, pitch, their errors, spikes, and tabs of other traces."""
    start = timeline.position[np.isfinite(timeline.position).all(axis=1)][0]
    tracked = BODY if BODY in timeline.poses else next(iter(timeline.poses))
    follow = rr.new_entity_path(["world", tracked, "outline"])
    eye = rrb.EyeControls3D(position=start + EYE, look_target=start, tracking_entity=follow)
    scene = rrb.Spatial3DView(origin="world", name="vehicle", eye_controls=eye)
    rows = [[views.pop(name) for name in row if name in views] for row in ROWS]
    if timeline.spikes:
        rows.append([rrb.TimeSeriesView(origin="spikes", name="spikes [neuron]")])
    rows.append([rrb.Tabs(*(views[name] for name in sorted(views, key=lambda name: name != "wind")))])
    plots = rrb.Vertical(*(rrb.Horizontal(*row) for row in rows))
    return rrb.Blueprint(rrb.Horizontal(scene, plots, column_shares=[2, 3]), collapse_panels=True)
