"""Tokens of an identity provider: what is taken, what is not, and how often its keys are asked for."""

import time
from collections.abc import Mapping

import jwt
import orjson
import pytest
from cryptography.hazmat.primitives.asymmetric import ec, rsa
from jwt.algorithms import ECAlgorithm, RSAAlgorithm
from jwt.utils import base64url_encode

from service.access.oidc import KeySet, Oidc, claim
from service.access.principal import Role
from service.access.provider import Provider, open_oidc
from service.errors import ConfigError, ForbiddenError, IdentityProviderError, UnauthorizedError
from service.settings import Settings

pytestmark = pytest.mark.anyio
PROVIDER = Provider("https://id.example", "skypose", "tenant", "roles.skypose")
RSA_KEY = rsa.generate_private_key(public_exponent=65537, key_size=2048)
EC_KEY = ec.generate_private_key(ec.SECP256R1())
SHARED = b"secret-" * 6
STRANGER = ec.generate_private_key(ec.SECP256R1())
JWKS = {
    "keys": [
        {**RSAAlgorithm.to_jwk(RSA_KEY.public_key(), as_dict=True), "kid": "rsa", "alg": "RS256"},
        {**ECAlgorithm.to_jwk(EC_KEY.public_key(), as_dict=True), "kid": "ec", "alg": "ES256"},
        {"kty": "oct", "k": base64url_encode(SHARED).decode(), "kid": "shared", "alg": "HS256"},
    ]
}
CLAIMS = {
    "iss": PROVIDER.issuer,
    "aud": [PROVIDER.audience, "another"],
    "sub": "someone",
    "tenant": "acme",
    "roles": {"skypose": ["read", "operate", "cook"]},
}


class Source:
    """The provider's address: counts how often it is asked."""

    def __init__(self, document: object = JWKS) -> None:
        self.document, self.asked = document, 0

    async def __call__(self) -> bytes:
        self.asked += 1
        if isinstance(self.document, Exception):
            raise self.document
        return orjson.dumps(self.document)


def oidc(source: Source | None = None) -> Oidc:
    return Oidc(PROVIDER, KeySet(source or Source(), 3600), 5.0)


def token(
    key=EC_KEY, kid: str | None = "ec", algorithm: str = "ES256", ends_s: float = 86_400, **changes: object
) -> str:
    claims = {**CLAIMS, "exp": int(time.time() + ends_s), **changes}
    claims = {name: value for name, value in claims.items() if value is not None}
    return jwt.encode(claims, key, algorithm, headers={} if kid is None else {"kid": kid})


def signed_by_hand(**changes: object) -> str:
    """With claims that the library itself would not sign."""
    claims = {**CLAIMS, "exp": int(time.time() + 86_400), **changes}
    return jwt.api_jws.encode(orjson.dumps(claims), EC_KEY, "ES256", headers={"kid": "ec"})


@pytest.mark.parametrize("made", [token(), token(RSA_KEY, "rsa", "RS256")])
async def test_good_token(made):
    caller = await oidc().verify(made)
    assert (caller.tenant, caller.key_id, caller.role) == ("acme", "oidc:someone", Role.OPERATE)


@pytest.mark.parametrize(
    "made",
    [
        token(STRANGER),
        token(kid="unknown"),
        token(kid=None),  # of three keys, which?
        token(ends_s=-120),
        token(iss="https://attacker.example"),
        token(aud="another"),
        token(aud=None),
        token(sub=None),
        token(exp=None),
        token(exp=10**18),
        token(exp=10**30),
        token(exp=float("inf")),
        token(iat=float("nan")),
        token(nbf=1e300),
        token(nbf=int(time.time()) + 86_000),
        token(SHARED, "shared", "HS256"),
        token(RSA_KEY, "ec", "RS256"),
        jwt.encode({**CLAIMS, "exp": int(time.time() + 86_400)}, None, "none", headers={"kid": "ec"}),
        signed_by_hand(iss=[PROVIDER.issuer]),
        signed_by_hand(iss=7),
        token()[:-4] + "AAAA",
        "a.b.c",
        "",
    ],
)
async def test_bad_token(made):
    with pytest.raises(UnauthorizedError):
        await oidc().verify(made)


@pytest.mark.parametrize(
    "changes",
    [
        {"tenant": None},
        {"tenant": "UPPER"},
        {"tenant": "a/b"},
        {"tenant": 5},
        {"roles": None},
        {"roles": {"skypose": ["cook"]}},
        {"roles": {"skypose": {"read": True}}},
    ],
)
async def test_token_that_gives_nothing_here(changes: Mapping[str, object]):
    with pytest.raises(ForbiddenError):
        await oidc().verify(token(**changes))


async def test_keys_are_asked_for_once_and_again_when_old_or_missing():
    source, now = Source(), [0.0]
    keys = KeySet(source, 3600, lambda: now[0])
    assert source.asked == 0  # before any token came
    for _ in range(3):
        await keys.get("ec")
    with pytest.raises(UnauthorizedError):
        await keys.get("new")
    assert source.asked == 1  # a made-up key makes nobody ask again at once
    now[0] = 31
    source.document = {"keys": [{**JWKS["keys"][1], "kid": "new"}]}
    assert (await keys.get("new")).key_id == "new"
    assert source.asked == 2
    source.document, now[0] = OSError("away"), 4000
    assert (await keys.get("new")).key_id == "new"  # what is known stays good
    assert source.asked == 3


@pytest.mark.parametrize("answer", [OSError("away"), {"keys": []}, {}, [], "x"])
async def test_provider_that_gives_no_keys(answer):
    with pytest.raises(IdentityProviderError):
        await oidc(Source(answer)).verify(token())


def test_claims_by_path():
    claims = {"a": {"b": "c"}, "https://x.example/role": "read", "a.b": "literal"}
    assert claim(claims, "a.b") == "literal"
    assert claim({"a": {"b": "c"}}, "a.b") == "c"
    assert claim(claims, "https://x.example/role") == "read"
    assert claim(claims, "a.c.d") is None


async def test_settings(tmp_path):
    assert open_oidc(Settings()) is None
    given = {"oidc_issuer": PROVIDER.issuer, "oidc_audience": "skypose", "oidc_role_claim": "roles.skypose"}
    with pytest.raises(ConfigError):
        open_oidc(Settings(**given))
    with pytest.raises(ConfigError, match="https"):
        open_oidc(Settings(**given, oidc_jwks="http://id.example/jwks"))
    file = tmp_path / "jwks.json"
    file.write_bytes(orjson.dumps(JWKS))
    opened = open_oidc(Settings(**given, oidc_jwks=str(file)))
    assert opened is not None
    assert (await opened.verify(token())).tenant == "acme"
