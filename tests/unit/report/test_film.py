"""Pictures of a report are cut around the object."""

import base64

import cv2
import numpy as np

from service.report.film import Shot, film, stills
from service.report.page import evenly


def png(x: int, y: int) -> bytes:
    """A grey frame with a bright square about a place."""
    picture = np.full((90, 120, 3), 30, np.uint8)
    picture[y - 3 : y + 3, x - 3 : x + 3] = 250
    return cv2.imencode(".png", picture)[1].tobytes()


SHOTS = [Shot(k, 20 + 5 * k, 40, {"overlay": png(20 + 5 * k, 40), "model": png(20 + 5 * k, 40)}) for k in range(4)]


def data(uri: str) -> np.ndarray:
    head, body = uri.split(",")
    assert head == "data:image/webp;base64"
    return np.frombuffer(base64.b64decode(body), np.uint8)


def test_the_object_stays_in_the_middle():
    for still in stills(SHOTS, 40.0):
        for uri in still.pictures.values():
            picture = cv2.imdecode(data(uri), cv2.IMREAD_GRAYSCALE)
            assert picture.shape == (256, 256)
            assert picture[118:138, 118:138].min() > 200
            assert picture[:40].max() < 80


def test_the_film_has_all_frames_side_by_side():
    done, moving = cv2.imdecodeanimation(data(film(SHOTS, 40.0)))
    assert done
    assert [frame.shape[:2] for frame in moving.frames] == [(256, 512)] * 4


def test_there_is_no_film_of_nothing():
    assert film([], 40.0) is None


def test_frames_are_spread_evenly():
    assert evenly(3, 5) == [0, 1, 2]
    assert evenly(101, 5) == [0, 25, 50, 75, 100]
