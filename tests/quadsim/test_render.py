import os
import subprocess
import sys

import imageio.v3 as imageio
import numpy as np
import pytest

from quadsim.config.toml import preset_names
from quadsim.pictures import film as films
from quadsim.pictures.film import Format, Marks, film
from quadsim.pictures.render import DRAFT, NO_OPENGL, WIND_SCALE, Scene, View, scene_model
from quadsim.pictures.shapes import quadrotor_geoms
from quadsim.rotation import quat_from_euler
from quadsim.vehicle import load_vehicle

VEHICLE = load_vehicle("hummingbird")
LEVEL = (1.0, 0.0, 0.0, 0.0)
VIEW = View((0.0, 0.0, 1.0))
PLACE = (0.3, 0.0, 1.2)


@pytest.fixture(scope="module", autouse=True)
def _opengl():
    try:
        Scene(VEHICLE, width=64, height=64).close()
    except RuntimeError as error:
        pytest.skip(str(error))


def still(position, quat, view, trail=None, width=320, height=180):
    scene = Scene(VEHICLE, width, height)
    image = scene.draw(position, quat, view, trail)
    scene.close()
    return image


def orange(image):
    red, green, blue = np.moveaxis(image.astype(int), -1, 0)
    return (red > 120) & (red > 2 * green - 20) & (red > 2 * blue)


def test_still_shows_the_vehicle_before_sky_and_ground():
    image = still((0, 0, 1), LEVEL, VIEW)
    assert image.shape == (180, 320, 3)
    assert image.dtype == np.uint8
    dark = (image.max(axis=-1) < 70).mean()
    assert 0.005 < dark < 0.3  # the carbon of arms and blades, and nothing else


def test_nose_is_orange_and_points_forward():
    above = View((0.0, 0.0, 1.0), distance=1.3, azimuth=90.0, elevation=-89.0)  # x to the right, y up
    image = still((0, 0, 1), LEVEL, above, width=640, height=640)
    nose = np.argwhere(orange(image)[:, 400:])
    tail = np.argwhere(orange(image)[:, :220])
    assert len(nose) > 2 * len(tail)


def test_the_trail_is_drawn():
    view = View((0.0, 0.0, 1.0), distance=2.5, azimuth=90.0)
    places = np.array([[-0.6, 0.0, 1.0], [0.6, 0.0, 1.0]])
    alone, joined = (still(places[0], LEVEL, view, trail) for trail in (None, places))
    assert np.any(joined[:, 150:170] != alone[:, 150:170])


@pytest.mark.parametrize("name", preset_names("vehicles"))
def test_geometry_is_that_of_the_vehicle(name):
    vehicle = load_vehicle(name)
    discs = [geom for geom in quadrotor_geoms(vehicle) if geom["material"] == "blur"]
    np.testing.assert_allclose([disc["pos"] for disc in discs], vehicle.hubs)
    assert {disc["size"][0] for disc in discs} == {vehicle.frame.prop_radius}


def test_film_of_nothing_is_refused(tmp_path):
    with pytest.raises(ValueError, match="at least two samples"):
        film(tmp_path / "x.mp4", VEHICLE, [0.0], [[0, 0, 1]], [LEVEL], Marks(*np.zeros((3, 1, 4))))


@pytest.mark.parametrize(
    ("blocked", "code"),
    [
        ({"mujoco.egl"}, "OK"),  # falls back to OSMesa
        ({"mujoco.egl", "mujoco.osmesa"}, NO_OPENGL),
    ],
)
def test_without_egl_osmesa_draws_and_without_both_the_message_helps(blocked, code):
    script = f"""
import importlib, sys
real = importlib.import_module
def import_module(name, package=None):
    if name in {blocked!r}:
        raise ImportError("not here")
    return real(name, package)
importlib.import_module = import_module
from quadsim.pictures.render import Scene
from quadsim.vehicle import load_vehicle
try:
    Scene(load_vehicle("hummingbird"), width=64, height=64).close()
    print("OK")
except RuntimeError as error:
    print(error)
"""
    environment = {key: value for key, value in os.environ.items() if not key.endswith(("_PLATFORM", "_GL"))}
    said = subprocess.check_output([sys.executable, "-c", script], text=True, env=environment).strip()
    if code == "OK" and said == NO_OPENGL:
        pytest.skip("OSMesa is not installed")
    assert said == code


def test_the_ghost_has_the_estimated_attitude_and_lets_the_vehicle_through():
    estimate = quat_from_euler(0.5, -0.2, 0.0)
    scene = Scene(VEHICLE, 160, 90, ghost=True)
    scene.draw((0, 0, 1), np.stack([LEVEL, estimate]), VIEW)
    np.testing.assert_allclose(scene.data.body("quadrotor1").xquat, estimate, atol=1e-12)
    bodies = [scene.model.body(f"quadrotor{k}").id for k in (0, 1)]
    own, ghost = (scene.model.geom_rgba[scene.model.geom_bodyid == body, 3] for body in bodies)
    assert (ghost < 0.5).all()
    assert not (own == ghost[0]).any()
    scene.close()


def test_the_arrow_points_where_the_wind_blows_to():
    wind = np.array([3.0, -4.0, 0.0])
    scene = Scene(VEHICLE, 160, 90)
    image = scene.draw((0, 0, 1), LEVEL, VIEW, target=PLACE, wind=wind)
    ball, arrow = (scene._scene.geoms[scene._scene.ngeom - k] for k in (2, 1))
    np.testing.assert_allclose(ball.pos, PLACE, atol=1e-6)
    np.testing.assert_allclose(arrow.mat[:, 2], wind / 5.0, atol=1e-6)
    assert arrow.size[2] == pytest.approx(WIND_SCALE * 5.0, rel=1e-5)
    drawn = scene._scene.ngeom
    assert (scene.draw((0, 0, 1), LEVEL, VIEW, wind=wind) != image).any()
    scene.draw((0, 0, 1), LEVEL, VIEW, target=PLACE, wind=np.zeros(3))
    assert scene._scene.ngeom == drawn - 1  # no arrow in calm air
    scene.close()


def test_a_film_plays_in_real_time(tmp_path, monkeypatch):
    monkeypatch.setattr(Format, "suited", lambda: Format(160, 96, 25.0))
    time = np.arange(21) / 50.0
    level, place = np.tile(LEVEL, (21, 1)), np.tile([0.0, 0.0, 1.0], (21, 1))
    tilted = quat_from_euler(np.full(21, np.radians(30.0)), np.zeros(21), np.zeros(21))
    marks = Marks(tilted, place, np.tile([2.0, 0.0, 0.0], (21, 1)))
    assert "30.0 deg" in marks.text(5, 0.1, LEVEL)[1]
    done = []
    path = film(tmp_path / "a.mp4", VEHICLE, time, place, level, marks, lambda *count: done.append(count))
    about = imageio.immeta(path)
    assert about["size"] == (160, 96)
    assert about["fps"] == 25.0
    assert about["duration"] == pytest.approx(0.4, abs=0.05)
    assert done == [(k + 1, 10) for k in range(10)]


def test_a_processor_draws_fewer_and_smaller_pictures_with_less_detail(monkeypatch):
    sizes = {}
    for processor in (False, True):
        monkeypatch.setattr(films, "drawn_by_processor", lambda processor=processor: processor)
        sizes[processor] = Format.suited()
    assert all(less < more for less, more in zip(sizes[True], sizes[False], strict=True))
    draft, fine = (scene_model(VEHICLE, 1, 64, 64, draft).vis.quality for draft in (True, False))
    assert all(getattr(draft, name) < getattr(fine, name) for name in DRAFT)
