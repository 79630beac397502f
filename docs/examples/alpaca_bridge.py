"""From an ASCOM Alpaca camera and mount to skypose: expose, fetch ImageBytes, post them with time and pointing.

    python alpaca_bridge.py --alpaca http://127.0.0.1:11111 --session ID --exposure 0.05 --frames 200

Most cameras and mounts have an Alpaca driver; those of INDI are reached through an INDI-to-Alpaca server. The bytes
of the image go through untouched: the service reads ImageBytes itself.
"""

import argparse
import itertools
import time
from datetime import UTC, datetime, timedelta
from typing import Any

import httpx

from service.client import Client

EQUATOR_OF_DATE, J2000 = 1, 2  # of a telescope's EquatorialSystem


class Alpaca:
    """One device of an Alpaca server (https://ascom-standards.org/api)."""

    def __init__(self, http: httpx.Client, device: str, number: int) -> None:
        self._http = http
        self._path = f"/api/v1/{device}/{number}"
        self._transaction = itertools.count(1)

    def get(self, member: str) -> Any:
        """A property. Raises ``RuntimeError`` with what the driver says."""
        answer = self._http.get(f"{self._path}/{member}", params=self._ids()).raise_for_status().json()
        return self._value(member, answer)

    def put(self, method: str, **values: Any) -> Any:
        """A method."""
        answer = self._http.put(f"{self._path}/{method}", data={**values, **self._ids()}).raise_for_status().json()
        return self._value(method, answer)

    def image_bytes(self) -> bytes:
        """The newest image, as it is."""
        head = {"Accept": "application/imagebytes"}
        answer = self._http.get(f"{self._path}/imagearray", params=self._ids(), headers=head).raise_for_status()
        if not answer.headers["content-type"].startswith("application/imagebytes"):
            raise RuntimeError("the camera's driver does not know ImageBytes")
        return answer.content

    def _ids(self) -> dict[str, int]:
        return {"ClientID": 1, "ClientTransactionID": next(self._transaction)}

    @staticmethod
    def _value(member: str, answer: dict[str, Any]) -> Any:
        if answer.get("ErrorNumber"):
            raise RuntimeError(f"{member}: {answer.get('ErrorMessage')}")
        return answer.get("Value")


def expose(camera: Alpaca, exposure_s: float, poll_s: float) -> tuple[bytes, datetime]:
    """An image and the middle of its exposure."""
    started = datetime.now(UTC)
    camera.put("startexposure", Duration=exposure_s, Light=True)
    while not camera.get("imageready"):
        time.sleep(poll_s)
    # The driver knows better when the shutter opened, where it says so.
    told = camera.get("lastexposurestarttime")
    if told:
        started = datetime.fromisoformat(told).replace(tzinfo=UTC)
    return camera.image_bytes(), started + timedelta(seconds=exposure_s / 2)


def pointing(mount: Alpaca) -> dict[str, float]:
    """Where the mount points, for the frame."""
    return {"ra_deg": 15.0 * mount.get("rightascension"), "dec_deg": mount.get("declination")}


def run(options: argparse.Namespace) -> None:
    """Frames from the camera into the session."""
    with httpx.Client(base_url=options.alpaca, timeout=60) as http, Client(options.url, api_key=options.key) as client:
        camera, mount = Alpaca(http, "camera", options.camera), Alpaca(http, "telescope", options.telescope)
        session = client.session(options.session)
        equinox = "date" if mount.get("equatorialsystem") == EQUATOR_OF_DATE else "J2000"
        if session.camera["equinox"] != equinox:
            print(f"the mount counts in {equinox}, the session in {session.camera['equinox']}: 0.37 deg apart in 2026")
        if session.state == "waiting_for_background":
            for _ in range(options.background):
                image, _ = expose(camera, options.exposure, options.poll)
                client.add_background(options.session, image, "application/imagebytes")
        for index in range(session.frames, session.frames + options.frames):
            image, middle = expose(camera, options.exposure, options.poll)
            estimate = client.put_frame(
                options.session, index, image, "application/imagebytes", time=middle, **pointing(mount)
            )
            print(
                estimate.index, estimate.time, estimate.status, f"{estimate.spread.orientation_deg:.2f} deg", flush=True
            )


def main() -> None:
    """Read the command line."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--alpaca", required=True, help="address of the Alpaca server")
    parser.add_argument("--camera", type=int, default=0)
    parser.add_argument("--telescope", type=int, default=0)
    parser.add_argument("--url", default="http://127.0.0.1:8000")
    parser.add_argument("--key")
    parser.add_argument("--session", required=True)
    parser.add_argument("--exposure", type=float, default=0.05, help="seconds")
    parser.add_argument("--poll", type=float, default=0.02, help="seconds between two looks at the camera")
    parser.add_argument("--background", type=int, default=3, help="frames of empty sky, where the session has none")
    parser.add_argument("--frames", type=int, default=100)
    run(parser.parse_args())


if __name__ == "__main__":
    main()
