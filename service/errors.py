"""Everything that can be refused or go wrong, as one tree.

::

    SkyposeError                          500  something of ours broke
    ├── InputError                        422  what was sent cannot be used
    │   ├── UnsupportedMediaTypeError     415  no decoder for this media type
    │   ├── SlowBodyError                 408  the rest of the body did not come
    │   ├── TooLargeError                 413  past a limit (bytes, pixels, faces, ...)
    │   ├── ImageError                    422  broken, truncated or empty image
    │   ├── ImageMismatchError            422  other size, channels or depth than the background
    │   ├── MeshFileError                 422  no usable mesh (no faces, NaN, unreadable)
    │   ├── JointError                    422  a joint that does not fit the model
    │   ├── ConfigError                   422  unknown field, or a value outside its limits
    │   ├── CheckpointError               422  no checkpoint, or of a format this release cannot read
    │   └── IdempotencyKeyError           422  the key was used with other content
    ├── UnauthorizedError                 401  no credential, or one that is not good
    ├── ForbiddenError                    403  the credential may not do this
    │   └── ForeignOriginError            403  a page of another site, or another name for this service
    ├── NotFoundError                     404  unknown model, session, estimate, ...
    ├── GoneError                         410  it was here and is no longer kept
    ├── ConflictError                     409  the resource is not in a state for this
    │   ├── NoBackgroundError             409  a frame before any background
    │   ├── FrameGapError                 409  a frame index that is not the next one
    │   ├── FrameConflictError            409  that index already holds other bytes
    │   ├── ModelInUseError               409  sessions still need the model
    │   └── BackendMissingError           409  the scorer's backend that the session names is not to be had here
    ├── BusyError                         503  try again after ``retry_after_s``
    │   ├── InboxFullError                429  this session has frames enough waiting
    │   ├── RateLimitedError              429  this key did too much in too short a time
    │   ├── QuotaExceededError            429  this tenant has as much as it may have
    │   ├── IdentityProviderError         503  the identity provider's keys cannot be had
    │   ├── WorkerFailedError             503  the worker died twice, or did not answer in time
    │   ├── ScorerFailedError             503  the scorer's device failed during a frame
    │   ├── StorageError                  503  the database refused a write (disk full, I/O error)
    │   ├── StaleOwnerError               503  another owner has taken the session
    │   └── StoppingError                 503  the service is shutting down
    ├── DamagedError                      500  what is stored is not what was stored
    └── MissingBlobError                  500  inside only: the worker needs bytes it has not got

Raised where the reason is known, turned into an RFC 9457 answer in one place (``service.api.problems``).
Errors cross process borders, so each is rebuilt from its detail and facts.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from functools import partial
from typing import Any, ClassVar


class SkyposeError(Exception):
    """Base of the tree.

    ``field`` names what was wrong in the request (``body``, ``header:Content-Type``, ``filter.particles``),
    ``facts`` are further members of the problem document: limits, found values; plain JSON values only.
    """

    slug: ClassVar[str] = "internal"
    title: ClassVar[str] = "Internal error"
    status: ClassVar[int] = 500

    def __init__(self, detail: str, *, field: str | None = None, **facts: Any) -> None:
        super().__init__(detail)
        self.detail = detail
        self.field = field
        self.facts = facts

    def __reduce__(self) -> tuple[Callable[..., SkyposeError], tuple[Any, ...]]:
        return partial(type(self), field=self.field, **self.facts), (self.detail,)


class InputError(SkyposeError):
    """What was sent cannot be used."""

    slug, title, status = "invalid-input", "Invalid input", 422


class UnsupportedMediaTypeError(InputError):
    """No decoder for this media type; ``supported`` lists those there are."""

    slug, title, status = "unsupported-media-type", "Unsupported media type", 415


class SlowBodyError(InputError):
    """The rest of the body did not come; ``setting`` says how long was waited, or at what rate it must come."""

    slug, title, status = "slow-body", "Body too slow", 408


class TooLargeError(InputError):
    """Past a limit; ``limit`` says how much is allowed, ``setting`` which setting says so."""

    slug, title, status = "too-large", "Too large", 413


class ImageError(InputError):
    """A broken, truncated or empty image."""

    slug, title = "broken-image", "Broken image"


class ImageMismatchError(InputError):
    """An image of other size, channels or depth than the background."""

    slug, title = "image-mismatch", "Image does not fit the background"


class MeshFileError(InputError):
    """No usable mesh."""

    slug, title = "broken-mesh", "Broken mesh"


class JointError(InputError):
    """A joint that does not fit the model."""

    slug, title = "invalid-joint", "Invalid joint"


class ConfigError(InputError):
    """An unknown field, or a value outside its limits. ``errors`` may list several."""

    slug, title = "invalid-configuration", "Invalid configuration"


class CheckpointError(InputError):
    """No checkpoint, a damaged one, or one of a format that this release cannot read."""

    slug, title = "broken-checkpoint", "Broken checkpoint"


class IdempotencyKeyError(InputError):
    """The idempotency key was used before with other content."""

    slug, title = "idempotency-key-reused", "Idempotency key used with other content"


class UnauthorizedError(SkyposeError):
    """No credential, or one that is not good (any more)."""

    slug, title, status = "unauthorized", "Not authenticated", 401


class ForbiddenError(SkyposeError):
    """The credential may not do this; ``needs`` says what could."""

    slug, title, status = "forbidden", "Not allowed", 403


class ForeignOriginError(ForbiddenError):
    """A page of another site, or another name for this service; ``setting`` says where to allow it."""

    slug, title = "foreign-origin", "Foreign origin"


class NotFoundError(SkyposeError):
    """Unknown model, session, estimate or submission."""

    slug, title, status = "not-found", "Not found", 404


class GoneError(SkyposeError):
    """It was here and is no longer kept (retention)."""

    slug, title, status = "gone", "No longer kept", 410


class ConflictError(SkyposeError):
    """The resource is not in a state for this call."""

    slug, title, status = "conflict", "Conflict", 409


class NoBackgroundError(ConflictError):
    """A frame before any background."""

    slug, title = "no-background", "No background yet"


class FrameGapError(ConflictError):
    """A frame index that is not the next one; ``expected`` is."""

    slug, title = "frame-gap", "Frame index is not the next"


class FrameConflictError(ConflictError):
    """That frame index already holds other bytes."""

    slug, title = "frame-conflict", "Frame index holds other content"


class ModelInUseError(ConflictError):
    """Sessions still need the model."""

    slug, title = "model-in-use", "Model in use"


class BackendMissingError(ConflictError):
    """The session names a backend of the scorer (`filter.backend`) that this server does not have."""

    slug, title = "backend-missing", "Backend not to be had"


class BusyError(SkyposeError):
    """Nothing was changed; try again after ``retry_after_s`` seconds (the Retry-After header)."""

    slug, title, status = "busy", "Busy", 503
    retry_after_s: ClassVar[int] = 1


class InboxFullError(BusyError):
    """This session has frames enough waiting; ``limit`` says how many."""

    slug, title, status = "inbox-full", "Too many frames waiting", 429


class RateLimitedError(BusyError):
    """This key did too much in too short a time; ``setting`` says of what, Retry-After how long to wait."""

    slug, title, status = "rate-limited", "Too much at once", 429


class QuotaExceededError(BusyError):
    """This tenant has as much as it may have; ``setting`` says of what."""

    slug, title, status = "quota-exceeded", "Quota exceeded", 429
    retry_after_s = 60


class IdentityProviderError(BusyError):
    """The identity provider's keys cannot be had."""

    slug, title = "identity-provider", "Identity provider not reached"
    retry_after_s = 30


class WorkerFailedError(BusyError):
    """The worker died, also on the second try, or did not answer in time (`limit`, `setting`)."""

    slug, title = "worker-failed", "Worker failed"


class ScorerFailedError(BusyError):
    """The scorer's device failed or ran out of memory during a frame, and no other was allowed to take over."""

    slug, title = "scorer-failed", "Scorer failed"


class StorageError(BusyError):
    """The database refused a write; nothing of it was stored, or the detail says that this is not known."""

    slug, title = "storage-failed", "Storage failed"
    retry_after_s = 2


class StaleOwnerError(BusyError):
    """Another owner has taken the session; the next call finds it."""

    slug, title = "owner-changed", "Session owner changed"


class StoppingError(BusyError):
    """The service is shutting down."""

    slug, title = "stopping", "Shutting down"
    retry_after_s = 5


class DamagedError(SkyposeError):
    """What is stored is not what was stored: its checksum is another. `skypose verify` tells what else is damaged."""

    slug, title = "damaged", "Stored data is damaged"


class MissingBlobError(SkyposeError):
    """The worker needs bytes it has not got; ``keys`` in the facts names them. Never leaves the service."""

    slug, title = "missing-blob", "Missing blob"

    @classmethod
    def of(cls, keys: Iterable[str]) -> MissingBlobError:
        """For the blobs of these keys."""
        names = sorted(keys)
        return cls(f"blobs not at hand: {', '.join(names)}", keys=names)

    @property
    def keys(self) -> tuple[str, ...]:
        """The keys asked for."""
        return tuple(self.facts.get("keys", ()))


def every_error() -> list[type[SkyposeError]]:
    """The whole tree, parents first: for the documentation and its test."""
    found: list[type[SkyposeError]] = [SkyposeError]
    for kind in found:
        found.extend(kind.__subclasses__())
    return found
