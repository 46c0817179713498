"""What other settings change of a loop, for better and for worse."""

from __future__ import annotations

from trueplant.result.controllers import BeforeAfter, LoopMetrics, TradeOff


def trade_off(name: str, today: LoopMetrics, proposed: LoopMetrics) -> TradeOff:
    """Of the loop that this input closes, on the plant; a number that either side lacks is None."""
    step, load, noise = (
        (now, new)
        if (now := getattr(today, part)) is not None and (new := getattr(proposed, part)) is not None
        else None
        for part in ("setpoint", "load", "noise")
    )
    return TradeOff(
        input=name,
        load_error=_change(load and load[0].iae, load and load[1].iae),
        overshoot=_change(step and step[0].overshoot, step and step[1].overshoot),
        settling=_change(step and step[0].settling, step and step[1].settling),
        Ms=_change(today.Ms, proposed.Ms),
        op_moves=_change(step and step[0].total_variation, step and step[1].total_variation),
        op_noise=_change(noise and noise[0].op_variation, noise and noise[1].op_variation),
        mu=_change(_upper(today), _upper(proposed)),
    )


def _upper(metrics: LoopMetrics) -> float | None:
    return None if metrics.mu is None else metrics.mu.upper


def _change(before: float | None, after: float | None) -> BeforeAfter | None:
    return None if before is None or after is None else BeforeAfter(before, after)


def trade_off_words(found: TradeOff, time_unit: str) -> str:
    """All of it in one line."""
    said = []
    if found.load_error is not None and (ratio := found.load_error.ratio) is not None:
        percent = f"{100 * (ratio - 1):+.0f}"
        said.append("error of a load step " + ("stays" if percent in ("+0", "-0") else f"{percent} %"))
    if found.overshoot is not None:
        said.append(f"overshoot {shown(found.overshoot, 100)} %")
    if found.settling is not None:
        said.append(f"settling {shown(found.settling)} {time_unit}")
    if found.Ms is not None:
        said.append(f"Ms {shown(found.Ms)}")
    for change, what in ((found.op_moves, "OP moves"), (found.op_noise, "noise moves OP")):
        if change is not None and change.ratio is not None:
            times = f"{change.ratio:.2g}"
            said.append(f"{what} as much" if times == "1" else f"{what} {times} times as much")
    if found.mu is not None:
        said.append(f"mu {shown(found.mu)}")
    return ", ".join(said) or "unstable with one of the two"


def shown(change: BeforeAfter, factor: float = 1.0) -> str:
    """Per cent whole; else whole from 10 on, and to a hundredth below: or 1.5 beside 46 were 2."""
    both = (factor * value for value in (change.before, change.after))
    before, after = (f"{value:.{0 if factor != 1 or abs(value) >= 10 else 2}f}" for value in both)
    return f"stays {after}" if before == after else f"{before} -> {after}"
