"""Check of a webhook's signature (Standard Webhooks)."""

from __future__ import annotations

import base64
import hashlib
import hmac
import time
from collections.abc import Mapping


def check_webhook(secret: str, headers: Mapping[str, str], body: bytes, tolerance_s: float = 300) -> bool:
    """True if a webhook was signed with `secret` and is recent. `body`: the bytes as received."""
    given = {key.lower(): value for key, value in headers.items()}
    try:
        signed = f"{given['webhook-id']}.{given['webhook-timestamp']}.".encode() + body
        is_recent = abs(time.time() - int(given["webhook-timestamp"])) <= tolerance_s
    except (KeyError, ValueError):
        return False
    key = base64.b64decode(secret[len("whsec_"):] if secret.startswith("whsec_") else secret)
    expected = b"v1," + base64.b64encode(hmac.new(key, signed, hashlib.sha256).digest())
    # As bytes: a forged header can have any characters, and texts are compared only if they are ASCII.
    signatures = given.get("webhook-signature", "").encode("utf-8", "replace").split()
    return is_recent and any(hmac.compare_digest(expected, signature) for signature in signatures)
