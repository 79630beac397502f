"""Settings of the process, from the environment (``SKYPOSE_...``). docs/settings.md lists every one.

What a session can choose is not here but in ``service.inference.params``, stored with the session.
"""

from __future__ import annotations

from ipaddress import ip_address
from pathlib import Path
from socket import gethostname
from typing import Annotated, Literal

from pydantic import Field, SecretStr
from pydantic_settings import BaseSettings, SettingsConfigDict

Positive = Annotated[int, Field(ge=1)]
PositiveSeconds = Annotated[float, Field(gt=0)]
MEBIBYTE = 1 << 20


class Settings(BaseSettings):
    """Process-wide settings; read once, handed down, never changed."""

    model_config = SettingsConfigDict(env_prefix="SKYPOSE_", frozen=True, extra="forbid")

    host: str = "127.0.0.1"
    """Address to listen on."""
    port: Annotated[int, Field(ge=0, le=65535)] = 8000
    """Port to listen on; 0 takes a free one."""
    data_dir: Path = Path("skypose-data")
    """Where the database lives."""
    database_url: SecretStr = SecretStr("")
    """`postgresql+psycopg://user:password@host/name` (extra `[postgres]`). Empty: SQLite in the data directory."""
    database_connections: Positive = 8
    """PostgreSQL: connections that write."""
    database_wait_s: PositiveSeconds = 10.0
    """PostgreSQL: how long a call waits for a server that is not there, or for a lock, before it is answered 503."""
    instance_url: str = ""
    """PostgreSQL: how the other processes reach this one. Empty: `http://`, its host and port."""
    lease_s: Annotated[float, Field(ge=1, le=300)] = 5.0
    """PostgreSQL: a process that is not heard of for so long loses its sessions to the others."""
    log_level: Literal["debug", "info", "warning", "error"] = "info"
    """Least severe log line that is written."""
    log_format: Literal["auto", "json", "text"] = "auto"
    """JSON lines for machines, text for people; ``auto``: text on a terminal, else JSON."""

    engine: Literal["process", "ray"] = "process"
    """What runs the workers: processes of this machine, or actors of a Ray cluster (docs/engines.md)."""
    ray_address: str = ""
    """`HOST:PORT` of the cluster; none: a Ray of its own on this machine, for as long as the service runs."""
    ray_actors: Annotated[int, Field(ge=0)] = 0
    """Actors of this service; 0: one per GPU of the cluster, without any one per `SKYPOSE_RAY_CORES`."""
    ray_cores: Positive = 1
    """Cores that each actor asks of Ray, shared by its tracking processes."""
    workers: Annotated[int, Field(ge=0)] = 0
    """Tracking processes, with Ray in each actor. 0: as many as there are cores, with 1 GiB of memory each; one is
    there from the start, the others wake when a frame would have to wait, and sleep after five idle minutes. With Ray
    0 is one. A session stays with one while that has room for its next frame."""
    batching: Literal["auto", "on", "off"] = "auto"
    """Whether several tracking processes share a device, which scores what they ask at one time in one launch: `auto`
    where there is a GPU, `on` anywhere. Only where `SKYPOSE_WORKERS` says how many they are."""
    worker_timeout_s: PositiveSeconds = 120.0
    """A worker that does not answer a job for so long is ended and started anew. The job is not tried again."""
    worker_start_timeout_s: PositiveSeconds = 120.0
    """How long a new worker may take until it is ready."""

    worker_nice: Annotated[int, Field(ge=0, le=19)] = 4
    """How far the worker processes stand back for the web process where they share cores (0 to 19)."""
    session_inbox_frames: Positive = 16
    """Frames a session holds waiting; one more is answered 429."""
    max_waiting_frames: Positive = 512
    """Frames waiting or under way in all sessions together; one more is answered 503, unless its tenant has less than
    an even share of them. Small: nobody waits long."""
    max_pending_mb: Positive = 512
    """Bytes of all waiting frames together, in MiB; more is answered 503."""
    session_idle_s: PositiveSeconds = 300.0
    """A session without calls for so long leaves memory until its next call."""
    max_resident_sessions: Positive = 256
    """Sessions held in memory; past that the longest idle ones leave."""
    shutdown_grace_s: PositiveSeconds = 30.0
    """How long a stop waits for the frames in hand."""

    max_frame_mb: Positive = 64
    """Body of a frame or background image, in MiB."""
    max_model_mb: Positive = 64
    """Body of a model upload, in MiB."""
    max_image_pixels: Positive = 1 << 26
    """Pixels of a frame or background file, all its frames together, as its header states them."""
    max_image_frames: Positive = 10_000
    """Frames in one file."""
    max_image_ratio: Positive = 200
    """Bytes of pixels per byte of a compressed file (gzip: of what it unpacks to), where the pixels are more than
    64 MiB."""
    max_header_kb: Positive = 1024
    """Header of a FITS file, in KiB."""
    max_model_faces: Positive = 1_000_000
    """Faces of a model, each as often as the file shows it."""
    max_model_vertices: Positive = 3_000_000
    """Vertices of a model, each as often as the file shows it."""
    max_model_nodes: Positive = 10_000
    """Nodes of a model's file."""
    max_model_parts: Positive = 512
    """Parts of a model: nodes with triangles."""
    max_model_joints: Positive = 64
    """Joints of a model, before any are tied."""
    max_model_moves: Positive = 20_000
    """Parts that the joints of a model move, each as often as a stage of a joint moves it."""
    max_model_depth: Positive = 64
    """Levels of nodes below each other in a GLB."""
    max_model_json_mb: Positive = 16
    """JSON chunk of a GLB, in MiB."""
    decode_memory_mb: Annotated[int, Field(ge=256)] = 2048
    """What decoding one file may take in memory, in MiB. Images and meshes are decoded in processes of their own."""
    decode_cpu_s: Positive = 20
    """What decoding one file may take of computing time."""
    decode_timeout_s: PositiveSeconds = 60.0
    """What decoding one file may take until there is an answer."""
    decode_sandbox: Literal["auto", "required", "off"] = "auto"
    """What the kernel forbids the decoding processes (docs/security.md): `auto` all that it can, `required` too, and
    the service does not start where a measure is missing, `off` nothing."""

    max_checkpoint_mb: Positive = 512
    """Body of a checkpoint, in MiB."""
    max_json_kb: Positive = 256
    """JSON body, in KiB."""
    max_page: Positive = 1000
    """Most entries in one page of a list."""

    keep_frame_bodies: Annotated[int, Field(ge=0)] = 1000
    """Frame files kept per session, newest first, for overlays. 0 keeps none."""
    keep_particle_sets: Positive = 64
    """Particle sets kept per session, newest first. The newest is the session's state."""
    keep_particle_every: Annotated[int, Field(ge=0)] = 16
    """Beside those, the particle set of every n-th frame is kept. 0 keeps no others."""

    end_idle_days: Annotated[float, Field(ge=0, le=36500)] = 0.0
    """A session that nobody sends frames to for so many days ends: it can be read, and takes no more. 0: never."""
    retain_ended_days: Annotated[float, Field(ge=0, le=36500)] = 0.0
    """A session that ended so many days ago is deleted with its whole history, when no frame waits. 0: never."""

    max_streams: Positive = 256
    """Watchers (WebSocket and event streams) at once; one more is answered 503."""
    stream_heartbeat_s: PositiveSeconds = 15.0
    """A silent stream sends a heartbeat so often."""
    stream_ring_events: Positive = 64
    """Newest events of a watched session held in memory; older ones are read from the database."""
    stream_max_lag_events: Positive = 1000
    """A live watcher further behind than this is told ``resync-required`` and goes on with the newest."""
    stream_send_timeout_s: PositiveSeconds = 30.0
    """A client that takes nothing of an answer or stream for so long is let go."""

    start_check_mb: Annotated[int, Field(ge=0)] = 1024
    """SQLite: a database of up to so many MiB is checked (`quick_check`) before the service starts."""
    disk_reserve_mb: Annotated[int, Field(ge=0)] = 64
    """SQLite: MiB of the disk held by a file in the data directory, to delete sessions with when the disk is full. 64
    are enough for one of some 90,000 frames. 0: none."""
    min_free_mb: Annotated[int, Field(ge=0)] = 64
    """SQLite: with less free on the disk of the data directory, in MiB, `/readyz` says so and answers 503."""
    reader_threads: Positive = 4
    """Threads that read the database."""

    auth: Literal["auto", "required", "off"] = "auto"
    """Whether calls need a key: `auto` not on a loopback address, `required` always, `off` never."""
    bootstrap_key_file: Path | None = None
    """File whose content (32 characters or more) is a key of the role `admin`, tenant `default`."""
    credential_cache_s: Annotated[float, Field(ge=0, le=300)] = 5.0
    """A credential found good is not looked up again for so long; so long a revoked key may still work."""
    ticket_s: Annotated[float, Field(gt=0, le=600)] = 30.0
    """How long a ticket for a browser's stream is good."""
    allowed_origins: str = ""
    """Origins of other sites whose pages may call, separated by spaces: `https://dome.example.org`."""
    allowed_hosts: str = ""
    """Names, beside IP addresses and `localhost`, by which it may be called without a key; spaces between, `*` any."""
    oidc_issuer: str | None = None
    """`iss` of the identity provider whose tokens are taken. With it go the next two."""
    oidc_audience: str | None = None
    """`aud` that its tokens must have."""
    oidc_jwks: str | None = None
    """The provider's public keys: a file, or an `https://` address."""
    oidc_jwks_cache_s: PositiveSeconds = 3600.0
    """How long those keys are kept before they are fetched again."""
    oidc_tenant_claim: str = "tenant"
    """Claim that names the tenant; a path such as `skypose.tenant` goes into objects."""
    oidc_role_claim: str = "role"
    """Claim that names the role, or a list with it; a path goes into objects."""

    rate_calls_per_s: Annotated[float, Field(ge=0)] = 2000.0
    """Calls of one key in a second; more are answered 429. 0: any number."""
    rate_megabytes_per_s: Annotated[float, Field(ge=0)] = 1000.0
    """MiB of request bodies of one key in a second; more are answered 429. 0: any."""
    rate_megapixels_per_s: Annotated[float, Field(ge=0)] = 2000.0
    """Millions of pixels of one key's frames in a second; more are answered 429. 0: any."""
    quota_sessions: Annotated[int, Field(ge=0)] = 10_000
    """Sessions of one tenant; one more is answered 429. 0: any number."""
    quota_keys: Annotated[int, Field(ge=0)] = 1000
    """Keys of one tenant that are not revoked, made over REST; one more is answered 429. 0: any number."""
    quota_objects: Annotated[int, Field(ge=0)] = 10_000
    """Objects of one tenant; one more is answered 429. 0: any number."""
    quota_models: Annotated[int, Field(ge=0)] = 1000
    """Models of one tenant; one more is answered 429. 0: any number."""
    quota_particles: Annotated[int, Field(ge=0)] = 100_000_000
    """Particles of all sessions of one tenant together; more are answered 429. 0: any number."""
    quota_stored_mb: Annotated[int, Field(ge=0)] = 0
    """MiB that one tenant may have stored (files, estimates, particles), measured every ten seconds; then what would
    store more is answered 429. 0: any."""
    quota_streams: Annotated[int, Field(ge=0)] = 192
    """Watchers of one tenant at once; one more is answered 429. 0: any number."""
    quota_pending_mb: Annotated[int, Field(ge=0)] = 448
    """Bytes of all waiting frames and other bodies of one tenant, in MiB; more is answered 429. 0: any."""
    quota_calls: Annotated[int, Field(ge=0)] = 512
    """Calls of one tenant under way at once, streams apart; one more is answered 429. 0: any number."""
    quota_heavy_reads: Annotated[int, Field(ge=0)] = 24
    """Of those, pictures and the like (`SKYPOSE_MAX_HEAVY_READS`); one more is answered 429. 0: any number."""
    max_key_calls: Annotated[int, Field(ge=0)] = 256
    """Calls of one key under way at once, streams apart; one more is answered 429. 0: any number."""
    max_calls: Positive = 1024
    """Calls under way at once, streams and heavy reads apart; one more is answered 503."""
    max_heavy_reads: Positive = 32
    """Pictures, meshes, particles, estimates, exports, reports, checkpoints read at once; one more is answered 503."""
    max_batches: Positive = 4
    """Files of several frames being tracked at once; one more is answered 503."""
    body_timeout_s: PositiveSeconds = 30.0
    """A client that sends nothing for so long in the middle of a body is answered 408."""
    body_kb_per_s: Annotated[float, Field(ge=0)] = 1.0
    """The least rate of a body in KiB/s, after the time above; a slower one is answered 408. 0: any."""
    max_page_files: Positive = 128
    """Files of the page and of the API's documentation, which need no key, being read at once; then 503."""
    max_connections: Positive = 4096
    """Connections in the middle of a call, and at most what the limit of open files leaves; then only probes."""
    max_connections_per_address: Annotated[int, Field(ge=0)] = 1024
    """Connections from one address that is no proxy (docs/security.md); past it one that waits is cut. 0: any."""
    head_timeout_s: PositiveSeconds = 10.0
    """A connection that has not sent the head of a call after so long is cut."""

    audit_days: Positive = 90
    """Entries of the audit log are kept so many days."""
    audit_max_entries: Positive = 100_000
    """Most entries of the audit log; the oldest go first."""

    @property
    def needs_credential(self) -> bool:
        """Whether calls must show a credential: always, never, or wherever others than this machine can reach it."""
        return self.auth == "required" or (self.auth == "auto" and not _is_loopback(self.host))

    @property
    def own_url(self) -> str:
        """How other processes on the same database reach this one."""
        host = gethostname() if self.host in ("0.0.0.0", "::") else self.host
        return (self.instance_url or f"http://{f'[{host}]' if ':' in host else host}:{self.port}").rstrip("/")


def _is_loopback(host: str) -> bool:
    try:
        return ip_address(host).is_loopback
    except ValueError:  # a name
        return host.lower() == "localhost"
