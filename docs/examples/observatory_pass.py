"""A pass as an observatory's scheduler would run it: one task posts frames, another watches the stream.

    python observatory_pass.py MESH BACKGROUND_FOLDER FRAMES_FOLDER --start 2026-11-20T03:04:05Z --interval 0.1
    python observatory_pass.py MESH BACKGROUND_FOLDER FRAMES_FOLDER --pointing pointing.csv

The watcher would be another program: a display in the dome, the loop that steers the mount. It is resumed wherever
its connection breaks, and hears of every frame exactly once.
"""

import argparse
import asyncio
import csv
from datetime import UTC, datetime, timedelta
from pathlib import Path

from service.client import AsyncClient, FrameFacts, RefusedError, frames_in


async def post_pass(client: AsyncClient, session_id: str, frames: list[Path], known: list[FrameFacts]) -> None:
    """Every frame at its own index: if this program is started again, nothing is tracked twice."""
    for index, (path, facts) in enumerate(zip(frames, known, strict=True)):
        await client.put_frame(session_id, index, path, **facts)


def read_pointing(path: Path) -> list[FrameFacts]:
    """Time and pointing of each frame, as the mount's log has them (`skypose simulate` writes such a file)."""
    with path.open(newline="") as file:
        return [
            {
                "time": datetime.fromisoformat(row["time"]),
                "ra_deg": float(row["ra_deg"]),
                "dec_deg": float(row["dec_deg"]),
                "position_angle_deg": float(row["position_angle_deg"]),
            }
            for row in csv.DictReader(file)
        ]


async def history(client: AsyncClient, session_id: str, wanted: str) -> tuple[str, bytes]:
    """Suffix and content: the attitude history, or a table of the poses where no frame had a pointing."""
    if wanted != ".csv":
        try:
            return wanted, await client.export(session_id, "aem")
        except RefusedError as error:
            print("no attitude file:", error.detail)
    return ".csv", await client.export(session_id, "csv")


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
        print(f"{estimate.time}  {angles}  ± {estimate.spread.orientation_deg:.1f} deg, modes: {len(estimate.modes)}")
        if estimate.index + 1 == count:
            return


async def run(options: argparse.Namespace) -> None:
    """The whole pass."""
    frames = frames_in(options.frames)
    step = timedelta(seconds=options.interval)
    known: list[FrameFacts] = [{"time": options.start + k * step} for k in range(len(frames))]
    if options.pointing is not None:
        known = read_pointing(options.pointing)
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
        for path in frames_in(options.background):
            await client.add_background(session.session_id, path)
        posting = post_pass(client, session.session_id, frames, known)
        await asyncio.gather(posting, watch(client, session.session_id, len(frames)))
        suffix, body = await history(client, session.session_id, options.out.suffix)
        options.out.with_suffix(suffix).write_bytes(body)
        print("written:", options.out.with_suffix(suffix))


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
    parser.add_argument("--pointing", type=Path, help="CSV: time, ra_deg, dec_deg, position_angle_deg of each frame")
    parser.add_argument("--up", type=float, help="angle of the image's up from north, degrees")
    parser.add_argument("--out", type=Path, default=Path("pass.aem"))
    asyncio.run(run(parser.parse_args()))


if __name__ == "__main__":
    main()
