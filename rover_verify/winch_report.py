"""`winch_report`: the winch's descent to 45 m and back, and how it judges its load, as one page.

The controller that `winch_node` runs is flown on the spatial plant, with errors of its sensors: the
descent that the requirements ask for, and descents drawn at random.
"""

from __future__ import annotations

import argparse
import base64
import html
import io
import json
import math
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from numpy.typing import NDArray
from tqdm import tqdm

from rover_verify.checks import Batch, Measured
from rover_verify.checks import winch as checks
from rover_verify.checks.winch_rig import Session

_BLUE, _ORANGE, _GREY = "#0072b2", "#d55e00", "#868e96"
_DPI = 110
_STYLE = """
body{margin:0;background:#f5f6f8;color:#1d2430;font:15px/1.5 system-ui,"DejaVu Sans",sans-serif}
main{max-width:1160px;margin:0 auto;padding:28px 20px 60px}
img{width:100%;background:#fff;border:1px solid #e3e6ec;border-radius:10px}
table{border-collapse:collapse;background:#fff;width:100%;font-variant-numeric:tabular-nums}
th,td{text-align:right;padding:7px 12px;border:1px solid #e3e6ec}
th:first-child,td:first-child{text-align:left} th{color:#667085;font-weight:600}
.wrong{color:#c62a2f;font-weight:700} p{max-width:75ch}
"""


def draw_descent(session: Session, begin: float, end: float, title: str) -> Figure:
    """Length, its error, rate, tension and torque between two times [s]."""
    time: NDArray[np.float64] = session.column("time") - session.ticks[0].time
    part = (time >= begin) & (time <= end)
    column = {
        name: session.column(name)[part]
        for name in ("length", "reference", "rate", "reference_rate", "tension", "torque")
    }
    time = time[part]
    figure = Figure(figsize=(11.5, 10.0), layout="constrained")
    axes = figure.subplots(5, 1, sharex=True, height_ratios=(3, 2, 2, 2, 2))
    figure.suptitle(title, x=0.01, ha="left", fontweight="bold")
    _lines(axes[0], time, "paid out [m]", reference=column["reference"], drum=column["length"])
    axes[0].invert_yaxis()
    error = 1e3 * (column["length"] - column["reference"])
    _lines(axes[1], time, "drum less\nreference [mm]", drum=error)
    rates = {"reference": column["reference_rate"], "drum": column["rate"]}
    _lines(axes[2], time, "payout rate [m/s]", **rates)
    _lines(axes[3], time, "tension at\nthe fairlead [N]", drum=column["tension"])
    _lines(axes[4], time, "motor [N m]", drum=column["torque"])
    axes[0].legend(loc="lower right", bbox_to_anchor=(1.0, 1.06), ncols=2, frameon=False)
    labelled = -math.inf
    for at, transition in session.transitions:
        shown = at - session.ticks[0].time
        if begin <= shown <= end and transition.name.startswith("winch_"):
            for axis in axes:
                axis.axvline(shown, color=_GREY, linewidth=0.8, linestyle=":")
            if shown - labelled < 0.04 * (end - begin):
                continue
            labelled = shown
            name = transition.name.removeprefix("winch_")
            axes[0].annotate(
                name, (shown, 1.0), xycoords=("data", "axes fraction"), fontsize=8,
                color="#495057", xytext=(2, 2), textcoords="offset points",
            )  # fmt: skip
    axes[-1].set_xlabel("time [s]")
    figure.align_ylabels()
    return figure


def _lines(
    axis: Axes, time: NDArray[np.float64], label: str, **values: NDArray[np.float64]
) -> None:
    looks = {"reference": (_ORANGE, 2.6), "drum": (_BLUE, 1.1)}
    for name, value in values.items():
        colour, width = looks[name]
        axis.plot(time, value, color=colour, linewidth=width, label=name)
    axis.set_ylabel(label)
    axis.grid(visible=True, color="#e3e6ea", linewidth=0.8)
    axis.spines[["top", "right"]].set_visible(False)
    axis.margins(x=0.005)


def _png(figure: Figure) -> bytes:
    buffer = io.BytesIO()
    FigureCanvasAgg(figure)
    figure.savefig(buffer, format="png", dpi=_DPI)
    return buffer.getvalue()


def descent_figures(session: Session) -> dict[str, Figure]:
    """The whole descent, its beginning, its stop at the bottom, and its end."""
    rests = [at - session.ticks[0].time for at in session.told("winch_hold")]
    begun = session.told("winch_length")[0] - session.ticks[0].time
    bottom = next(at for at in rests if at > begun)
    end = session.ticks[-1].time - session.ticks[0].time
    return {
        "descent": draw_descent(session, 0.0, end, "2.2 m to 45 m and back at 0.3 m/s"),
        "begin": draw_descent(session, begun - 0.5, begun + 6.0, "It starts"),
        "bottom": draw_descent(session, bottom - 5.0, bottom + 9.0, "It stops and turns back"),
        "top": draw_descent(session, end - 16.0, end, "It slows down before its end"),
    }


def figures_of(batch: Batch) -> dict[str, Measured]:
    """What the descent is held to."""
    return {
        "Largest distance of the drum's length from its reference [m]": checks.length_error(batch),
        "Overshoot [m]": checks.overshoot(batch),
        "Tension ripple in steady payout, RMS over mean": checks.ripple(batch),
    }


def render(
    figures: Mapping[str, bytes],
    measured: Mapping[str, Measured],
    tally: Sequence[checks.Tally],
    seed: int,
) -> str:
    """The page."""
    rows = "".join(
        f"<tr><td>{html.escape(name)}</td><td>{value.value:.4g}</td></tr>"
        for name, value in measured.items()
    )
    pictures = "".join(
        f'<p><img alt="{name}" src="data:image/png;base64,{base64.b64encode(data).decode()}"></p>'
        for name, data in figures.items()
    )
    return (
        '<!doctype html><html lang="en"><head><meta charset="utf-8"><title>Winch</title>'
        f"<style>{_STYLE}</style></head><body><main><h1>The winch of mother_rover</h1>"
        f"<h2>Descent</h2><table><tr><th>measured, seed {seed}</th><th></th></tr>{rows}</table>"
        f"{pictures}{_tally_table(tally, seed)}</main></body></html>\n"
    )


def _tally_table(tally: Sequence[checks.Tally], seed: int) -> str:
    if not tally:
        return ""
    head = (
        "descents with ...", "descents", "hard stops", "touches of the wall", "snags",
        "touchdown missed", "false", "snag missed", "false", "slack false",
    )  # fmt: skip
    body = ""
    for line in tally:
        counts = (line.descents, line.hard_stops, line.touches, line.snags)
        wrong = (
            line.touchdowns_missed, line.touchdowns_false, line.snags_missed, line.snags_false,
            line.slack_false,
        )  # fmt: skip
        body += f"<tr><td>{html.escape(line.name)}</td>"
        body += "".join(f"<td>{count}</td>" for count in counts)
        body += "".join(f"<td{' class=wrong' * bool(n)}>{n}</td>" for n in wrong) + "</tr>"
    return (
        f"<h2>Judgement of the load</h2><p>Descents drawn at random (seed {seed}) in legs of "
        "lowering and raising, ended smoothly or by a hard stop, along a wall, sometimes caught "
        "under a lip, in the end at 0.1 m/s to the floor. The winch knows neither payload nor "
        "friction nor its load cell's errors. Each line counts the descents that had to bear what "
        "it names; every descent ends in one touchdown.</p><table><tr>"
        + "".join(f"<th>{name}</th>" for name in head)
        + f"</tr>{body}</table>"
    )


def main(arguments: Sequence[str] | None = None) -> int:
    """Fly, draw and write; exit code 2 if the folder cannot be written."""
    parser = argparse.ArgumentParser(prog="winch_report", description=__doc__)
    parser.add_argument("--runs", type=int, default=20, help="descents drawn at random; 0 = none")
    parser.add_argument("--seed", type=int, default=1, help="seed of everything random")
    parser.add_argument("--out", type=Path, default=Path("out/winch"), help="folder")
    options = parser.parse_args(arguments)
    if options.runs < 0 or options.seed < 0:
        parser.error("--runs and --seed must not be below 0")
    try:
        options.out.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        parser.error(f"--out {options.out}: cannot be written: {error.strerror}")
    with tqdm(total=options.runs + 1, unit="descent", leave=False) as bar:

        def progress(done: int, _total: int) -> None:
            bar.n = done + 1
            bar.refresh()

        batch = Batch(options.runs, options.seed, options.out, progress)
        session = checks.descent(options.seed)
        figures = {name: _png(figure) for name, figure in descent_figures(session).items()}
        bar.update()
        tally = checks.tally(checks.trials(batch)) if options.runs else []
    measured = figures_of(batch)
    for name, data in figures.items():
        (options.out / f"{name}.png").write_bytes(data)
    content = {
        "seed": options.seed,
        "descent": {name: value.value for name, value in measured.items()},
        "judgement": [line._asdict() for line in tally],
    }
    (options.out / "winch.json").write_text(json.dumps(content, indent=1) + "\n", encoding="utf-8")
    page = options.out / "index.html"
    page.write_text(render(figures, measured, tally, options.seed), encoding="utf-8")
    for name, value in measured.items():
        print(f"{name}: {value.value:.4g}")
    for line in tally:
        print(line)
    print(f"Written: {page}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
