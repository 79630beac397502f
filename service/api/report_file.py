"""Reports as HTML that runs nothing and loads nothing."""

from __future__ import annotations

from fastapi import Response

_POLICY = "sandbox; default-src 'none'; style-src 'unsafe-inline'; img-src data:; frame-ancestors 'none'"


def report_file(body: bytes, name: str) -> Response:
    """A report, to be shown or saved as ``name``.html."""
    headers = {"Content-Disposition": f'inline; filename="{name}.html"', "Content-Security-Policy": _POLICY}
    return Response(body, media_type="text/html", headers=headers)
