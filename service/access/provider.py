"""The identity provider that the settings name. What checks its tokens is loaded only where there is one."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from service.errors import ConfigError
from service.settings import Settings

if TYPE_CHECKING:
    from service.access.oidc import Oidc


@dataclass(frozen=True)
class Provider:
    """Whose tokens are taken, for whom they must be made out, and which claims say what they may."""

    issuer: str
    audience: str
    tenant_claim: str
    role_claim: str


def open_oidc(settings: Settings) -> Oidc | None:
    """As the settings say; None where no provider is configured. Raises ``ConfigError`` for half a configuration."""
    given = (settings.oidc_issuer, settings.oidc_audience, settings.oidc_jwks)
    if not any(given):
        return None
    issuer, audience, jwks = given
    if not issuer or not audience or not jwks:
        raise ConfigError(
            "SKYPOSE_OIDC_ISSUER, SKYPOSE_OIDC_AUDIENCE and SKYPOSE_OIDC_JWKS belong together",
            field="SKYPOSE_OIDC_ISSUER",
        )
    from service.access.oidc import open_provider  # cryptography takes a tenth of a second of every start

    provider = Provider(issuer, audience, settings.oidc_tenant_claim, settings.oidc_role_claim)
    return open_provider(provider, jwks, settings)
