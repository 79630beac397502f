"""``skypose motion``: how the object of a session turned."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated

import typer

from service.cli.remote_options import DEFAULT_URL, Key, Url, connected

if TYPE_CHECKING:
    from service.api.motion import AttitudeMode, JointMotion, PassMotion, Vector


def motion(
    session: Annotated[str | None, typer.Argument(help="The session's id.")] = None,
    of_object: Annotated[
        str | None, typer.Option("--object", help="Instead: an object's id; by all telescopes of a pass.")
    ] = None,
    number: Annotated[
        int | None, typer.Option("--pass", min=0, help="Of the object, from 0; the last by default.")
    ] = None,
    as_json: Annotated[bool, typer.Option("--json", help="The whole answer as JSON.")] = False,
    url: Url = DEFAULT_URL,
    key: Key = None,
) -> None:
    """Rate, axis and period of a pass, from all its frames (docs/motion.md)."""
    if (session is None) == (of_object is None):
        raise typer.BadParameter("give a session, or --object", param_hint="SESSION")
    with connected(url, key) as client:
        if of_object is not None:
            found: PassMotion = client.object_motion(of_object, number)
        else:
            found = client.motion(session or "")
    typer.echo(found.model_dump_json(indent=2, by_alias=True) if as_json else "\n".join(lines(found)))


def lines(found: PassMotion) -> list[str]:
    """The answer for people."""
    told, frames = found.probabilities, found.frames
    period = "not seen" if found.period_s is None else f"{found.period_s:.3f} ± {found.period_sigma_s:.3f} s"
    out = [
        f"model      {found.model} (constant rate {told.constant_rate:.3f}, tumbling {told.tumbling:.3f})",
        f"rate       {found.rate_deg_s:.4f} ± {found.rate_sigma_deg_s:.4f} °/s against {found.relative_to}",
        f"body       {_vector(found.angular_velocity_body_deg_s)} ± {_vector(found.sigma_deg_s)} °/s",
        f"period     {period}",
        f"axis body  {_vector(found.axis_body)} ± {found.axis_body_sigma_deg:.2f}°",
    ]
    if found.axis_gcrf is not None:
        out.append(f"axis GCRF  {_vector(found.axis_gcrf)} ± {found.axis_gcrf_sigma_deg:.2f}°")
    if found.attitude_mode is not None:
        out.append(f"mode       {mode_line(found.attitude_mode)}")
    out += [f"joint      {joint_line(joint)}" for joint in found.joints]
    if found.inertia is not None:
        ratios = " ".join(
            f"{value:.3f} ± {sigma:.3f}"
            for value, sigma in zip(found.inertia.ratios, found.inertia.ratios_sigma, strict=True)
        )
        out.append(f"inertia    {ratios} of the greatest; nutation {found.inertia.nutation_deg:.1f}°")
    out.append(f"frames     {frames.used} of {frames.stored}, {frames.explained:.0%} of these explained")
    out.append(f"certainty  {found.probability:.3f}")
    return out + [f"note       {warning}" for warning in found.warnings]


def mode_line(mode: AttitudeMode) -> str:
    """What holds the body, how surely, and how far off."""
    name = mode.mode.replace("_", " ")
    line = f"{name} (p {getattr(mode.probabilities, mode.mode):.3f})"
    if mode.offset_deg is None:
        return line
    return f"{line}, {mode.body_axis}, {mode.offset_deg:.2f} ± {mode.sigma_deg:.2f}° off"


def joint_line(joint: JointMotion) -> str:
    """What a hinge does, how surely, and where."""
    line = f"{joint.name}: {joint.law.replace('_', ' ')} (p {getattr(joint.probabilities, joint.law):.3f})"
    if joint.sigma_deg is None:
        return line
    value = joint.value_deg if joint.law == "still" else joint.offset_deg
    return f"{line}, {value:.2f} ± {joint.sigma_deg:.2f}°{'' if joint.law == 'still' else ' from the Sun'}"


def _vector(vector: Vector) -> str:
    return f"({vector.x:.4f}, {vector.y:.4f}, {vector.z:.4f})"
