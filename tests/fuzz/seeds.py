"""Good inputs, small, one of each kind: what the fuzzer spoils."""

import gzip
import io
import json
import struct
import tempfile
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
import trimesh
from astropy.io import fits
from trimesh.exchange.dae import export_collada

from gpu.urdf_archive import pack_urdf

SIZE = (24, 32)  # rows, columns
ROBOT = b"""<robot name="r"><link name="body"><visual><geometry><box size="1 1 1"/></geometry></visual></link>
<link name="panel"><visual><geometry><mesh filename="box.dae" scale="1 2 1"/></geometry></visual></link>
<joint name="drive" type="continuous"><parent link="body"/><child link="panel"/><origin xyz="0 1 0"/><axis xyz="0 1 0"/>
</joint></robot>"""


@dataclass(frozen=True)
class Seed:
    """A good input. ``kind`` is a media type, or the file type of a mesh."""

    kind: str
    body: bytes
    mesh: bool = False


def grey(bits: int = 8, frames: int = 1) -> np.ndarray:
    """(frames, rows, columns) of noise."""
    rng = np.random.default_rng(bits + frames)
    return rng.normal(40, 5, (frames, *SIZE)).clip(0).astype(np.uint8 if bits == 8 else np.uint16)


def image_seeds() -> list[Seed]:
    """Every format of single images, and of several in a file."""
    colour = np.dstack([grey()[0]] * 3)
    many = cv2.imencodemulti(".tiff", list(grey(16, 3)))[1].tobytes()
    return [
        Seed("image/png", encoded(".png", grey()[0])),
        Seed("image/png", encoded(".png", grey(16)[0])),
        Seed("image/png", encoded(".png", np.dstack([colour, grey()[0]]))),
        Seed("image/jpeg", encoded(".jpg", colour)),
        Seed("image/jpeg", encoded(".jpg", grey()[0], cv2.IMWRITE_JPEG_PROGRESSIVE, 1)),
        Seed("image/tiff", encoded(".tiff", grey(16)[0])),
        Seed("image/tiff", encoded(".tiff", colour)),
        Seed("image/tiff", many),
        *(Seed("image/fits", body) for body in fits_files()),
        Seed("application/x-npy", npy(grey(16)[0])),
        Seed("application/x-npy", npy(grey(8, 3).astype(np.float32))),
        Seed("application/imagebytes", imagebytes(grey(16)[0])),
        Seed("video/x-ser", ser(grey(16, 2))),
    ]


def encoded(extension: str, image: np.ndarray, *options: int) -> bytes:
    """An image file by OpenCV."""
    return cv2.imencode(extension, image, options)[1].tobytes()


def npy(array: np.ndarray) -> bytes:
    """NumPy's own format."""
    stream = io.BytesIO()
    np.save(stream, array)
    return stream.getvalue()


def imagebytes(image: np.ndarray) -> bytes:
    """ASCOM ImageBytes of unsigned 16-bit pixels."""
    rows, columns = image.shape
    return struct.pack("<11i", 1, 0, 0, 0, 44, 8, 8, 2, columns, rows, 0) + image.T.astype("<u2").tobytes()


def ser(stack: np.ndarray) -> bytes:
    """SER of 16-bit frames with time stamps."""
    count, rows, columns = stack.shape
    head = struct.pack("<14s7i40s40s40s2q", b"LUCAM-RECORDER", 0, 0, 0, columns, rows, 16, count, b"", b"", b"", 0, 0)
    return head + stack.astype("<u2").tobytes() + struct.pack(f"<{count}q", *(638_000_000_000_000_000,) * count)


def fits_files() -> list[bytes]:
    """Plain, a cube, tile-compressed, in gzip."""
    header = fits.Header({"DATE-OBS": "2026-11-20T03:04:05", "EXPTIME": 0.5, "RA": 10.0, "DEC": 20.0})
    hdus = [
        fits.PrimaryHDU(grey(16)[0], header),
        fits.PrimaryHDU(grey(16, 2).astype(np.float32), header),
    ]
    files = [written(fits.HDUList([hdu])) for hdu in hdus]
    packed = fits.CompImageHDU(grey(16)[0], header, compression_type="RICE_1")
    return [*files, written(fits.HDUList([fits.PrimaryHDU(), packed])), gzip.compress(files[0])]


def written(hdus: fits.HDUList) -> bytes:
    """A FITS file's bytes."""
    stream = io.BytesIO()
    hdus.writeto(stream)
    return stream.getvalue()


def video_seeds() -> list[Seed]:
    """Two containers, two codecs."""
    found = []
    with tempfile.TemporaryDirectory() as folder:
        for name, codec, kind in (("a.avi", "MJPG", "video/avi"), ("b.mp4", "mp4v", "video/mp4")):
            path = Path(folder) / name
            writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*codec), 10, SIZE[::-1])
            for image in grey(8, 3):
                writer.write(np.dstack([image] * 3))
            writer.release()
            found.append(Seed(kind, path.read_bytes()))
    return found


def mesh_seeds() -> list[Seed]:
    """Every mesh format; a GLB of two nodes, as it is and compressed; a robot with a COLLADA mesh."""
    box = trimesh.creation.box((1.0, 2.0, 0.5))
    scene = trimesh.Scene()
    scene.add_geometry(box, node_name="body")
    scene.add_geometry(box, node_name="panel", parent_node_name="body", transform=np.diag([2.0, 0.5, 1, 1]))
    files = {kind: as_bytes(box.export(file_type=kind)) for kind in ("stl", "obj", "ply", "stl_ascii")}
    files["glb"] = as_bytes(scene.export(file_type="glb"))
    files["glb_draco"] = as_bytes(scene.export(file_type="glb", extension_draco=True))
    files["urdf"] = pack_urdf(ROBOT, {"box.dae": export_collada(box)})
    return [Seed(kind.partition("_")[0], body, mesh=True) for kind, body in files.items()]


def as_bytes(file: bytes | str) -> bytes:
    """Some exporters give text."""
    return file.encode() if isinstance(file, str) else file


TLE = (
    "1 25544U 98067A   26324.50000000  .00010000  00000-0  18000-3 0  9995\n"
    "2 25544  51.6400 100.0000 0005000  50.0000 310.0000 15.50000000    04"
)
MOTION = {
    "kind": "constant_velocity",
    "rotation_deg": 2.5,
    "position": 0.05,
    "log_scale": 0.016,
    "joint_deg": 3.0,
    "joint_range": 0.02,
    "rate_spread": 10.0,
    "rate_change": 2.0,
    "frame_interval_s": 0.1,
}


def json_seeds(model: str = "MODEL", other: str = "OTHER", joints: tuple[str, ...] = ()) -> list[bytes]:
    """Good bodies of ``POST /v1/sessions`` with every field there is; ``joints`` are those of ``model``."""
    full = {
        "model_id": model,
        "name": "x",
        "filter": {"preset": "balanced", "method": "auto", "particles": 100, "seed": 3, "resampler": "systematic"},
        "prior": {"min_extent": 0.05, "max_extent": 0.9, "scale_px": 3.0, "scale_sigma": 0.03, "mesh_error": 0.02},
        "motion": MOTION,
        "camera": {"mirrored": False, "perspective": 800.0, "principal_point": [16.0, 12.0], "transfer": 0.45},
        "joints": {"free": list(joints), "fixed": {}, "sun_tracking": list(joints), "sun_tracking_sigma_deg": 5.0},
        "light": {"sun": [0.3, -0.2, -0.9], "sun_sigma_deg": 1.0},
    }
    known = {
        "model_id": model,
        "background": "auto",
        "filter": {"particles": 60},
        "prior": {"orbit": TLE, "unit_m": 1.0, "scale_tolerance": 0.1, "attitude_mode": "yaw_steering"},
        "camera": {
            "mount": "altaz",
            "up_angle_deg": 10.0,
            "equinox": "date",
            "pixel_scale_arcsec": 0.2,
            "binning": 2,
            "site_latitude_deg": 48.0,
            "site_longitude_deg": 11.0,
            "site_height_m": 500.0,
            "psf_sigma_px": 1.5,
            "roi": [2, 2, 20, 16],
            "background": "auto",
            "headers": "use",
            "ser_byte_order": "little",
        },
        "joints": {"free": "all"},
        "light": {"sun": "auto"},
    }
    paper = {
        "model_id": model,
        "filter": {"preset": "paper", "method": "bootstrap", "particles": 60, "backend": "cpu", "step": "host"},
        "likelihood": {"feature": "intensity", "gradient_sigma_px": 1.0},
        "camera": {"transfer": "srgb"},
    }
    plain = ({"model_id": model}, {"model_ids": [model, other]})
    return [json.dumps(one).encode() for one in (full, known, paper, *plain)]
