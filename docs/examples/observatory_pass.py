"""A pass as an observatory's scheduler would run it: one task posts frames, another watches the stream.

    python observatory_pass.py MESH BACKGROUND_FOLDER FRAMES_FOLDER --start 2026-11-20T03:04:05Z --interval 0.1

The watcher would be another program: a display in the dome, the loop that steers the mount. It is resumed wherever
its connection breaks, and hears of every frame exactly once.
"""

import argparse
import asyncio
from datetime import UTC, datetime, timedelta
from pathlib import Path

from service.client import AsyncClient, RefusedError


async def post_pass(client: AsyncClient, session_id: str, frames: list[Path], start: datetime, interval_s: float):
    """Every frame at its own index: if this program is started again, nothing is tracked twice."""
    for index, path in enumerate(frames):
        time = start + timedelta(seconds=interval_s * index)
        await client.put_frame(session_id, index, path, time=time)


async def watch(client: AsyncClient, session_id: str, count: int) -> None:
    """Tell what comes, and say when the track is lost or found."""
    status = None
    async for event in client.watch(session_id, after=0):
        estimate = event.estimate
        if estimate is None:  # resync-required, or the session's end
            print(event.type, event.reason or "")
            continue
        if estimate.status != status:
            status = estimate.status
            print(f"--- {status}")
        best = estimate.best
        angles = f"{best.yaw_deg:7.1f} {best.pitch_deg:7.1f} {best.roll_deg:7.1f}"
        print(f"{estimate.time}  {angles}  ± {estimate.spread.orientation_deg:.1f} deg, {len(estimate.modes)} modes")
        if estimate.index + 1 == count:
            return


async def run(options: argparse.Namespace) -> None:
    """The whole pass."""
    frames = sorted(path for path in options.frames.iterdir() if path.is_file())
    async with AsyncClient(options.url, api_key=options.key) as client:
        model = await client.upload_model(options.mesh)
        for warning in model.warnings:
            print("model:", warning)
        session = await client.create_session(
            model.model_id,
            name=options.mesh.stem,
            joints={"free": "all"},
            motion={"frame_interval_s": options.interval},
            camera={"up_angle_deg": options.up} if options.up is not None else {},
        )
        for path in sorted(options.background.iterdir()):
            await client.add_background(session.session_id, path)
        posting = post_pass(client, session.session_id, frames, options.start, options.interval)
        await asyncio.gather(posting, watch(client, session.session_id, len(frames)))
        try:
            form = "csv" if options.out.suffix == ".csv" else "aem"
            options.out.write_bytes(await client.export(session.session_id, form))
            print("written:", options.out)
        except RefusedError as error:  # no frame had a pointing: there is no absolute attitude to export
            print("no attitude file:", error.detail)


def main() -> None:
    """Read the command line."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("mesh", type=Path)
    parser.add_argument("background", type=Path)
    parser.add_argument("frames", type=Path)
    parser.add_argument("--url", default="http://127.0.0.1:8000")
    parser.add_argument("--key")
    parser.add_argument("--start", type=datetime.fromisoformat, default=datetime.now(UTC))
    parser.add_argument("--interval", type=float, default=0.1)
    parser.add_argument("--up", type=float, help="angle of the image's up from north, degrees")
    parser.add_argument("--out", type=Path, default=Path("pass.aem"))
    asyncio.run(run(parser.parse_args()))


if __name__ == "__main__":
    main()
