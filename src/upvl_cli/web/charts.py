"""Charts as SVG that stands in a page: no script, no style of its own, and a text for those who cannot see it."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from upvl_cli.types import Floats, Ints

WIDTH, HEIGHT = 440, 130  # on a phone a unit is a little less than a pixel
_LEFT, _BOTTOM, _TOP = 36, 22, 8


def histogram(counts: Ints, threshold: float) -> str:
    """Return bars of a histogram of scores from 0 to 1; those below the threshold are faded.

    Args:
        counts: (b,) hits in each of b equal bins.
        threshold: Minimum score of a hit.
    """
    most, bins = max(int(counts.max()), 1), len(counts)
    width, height = (WIDTH - _LEFT - 4) / bins, HEIGHT - _BOTTOM - _TOP
    parts = []
    for place, count in enumerate(counts.tolist()):
        # A single hit among thousands must be seen.
        tall = max(height * count / most, 2.0) if count else 0.0
        kind = "bar" if (place + 1) / bins > threshold else "bar faded"
        title = f"{count} hits with scores from {place / bins:.2f} to {(place + 1) / bins:.2f}"
        parts.append(
            f'<rect class="{kind}" data-upper="{(place + 1) / bins:g}" x="{_LEFT + place * width + 1:.1f}" '
            f'y="{_TOP + height - tall:.1f}" width="{width - 2:.1f}" height="{tall:.1f}"><title>{title}</title></rect>'
        )
    x = _LEFT + threshold * width * bins
    parts.append(f'<line class="threshold" x1="{x:.1f}" x2="{x:.1f}" y1="0" y2="{HEIGHT - _BOTTOM}"/>')
    label = f"Histogram of the scores of {int(counts.sum())} tracks; the threshold is {threshold:.2f}"
    return _chart(label, parts, (0.0, 1.0), (0, most), "score")


def lines(time_s: Floats, values: Floats, at_s: float, unit: str, label: str) -> str:
    """Return a curve over time with a mark at one moment.

    Args:
        time_s: (n,) times, ascending; at least one.
        values: (n,) numbers from 0 on.
        at_s: The moment that is marked.
        unit: Unit of the numbers.
        label: What the chart shows, as a text.
    """
    low, high = float(time_s[0]), float(max(time_s[-1], time_s[0] + 0.1))
    most = max(float(np.nanmax(values)), 1.0)
    height = HEIGHT - _BOTTOM - _TOP
    x = _LEFT + (time_s - low) / (high - low) * (WIDTH - _LEFT - 8)
    y = _TOP + height * (1 - values / most)
    path = " ".join(f"{a:.1f},{b:.1f}" for a, b in zip(x.tolist(), y.tolist(), strict=True))
    mark = _LEFT + (min(max(at_s, low), high) - low) / (high - low) * (WIDTH - _LEFT - 8)
    parts = [
        f'<polyline class="curve" points="{path}"/>',
        f'<line class="threshold" x1="{mark:.1f}" x2="{mark:.1f}" y1="0" y2="{HEIGHT - _BOTTOM}"/>',
    ]
    return _chart(label, parts, (low, high), (0, most), f"time (s); vertical: {unit}")


def _chart(
    label: str, parts: Sequence[str], x_range: tuple[float, float], y_range: tuple[float, float], axis: str
) -> str:
    base = HEIGHT - _BOTTOM
    texts = [
        (_LEFT - 5, _TOP + 10, "end", f"{y_range[1]:g}" if y_range[1] >= 10 else f"{y_range[1]:.3g}"),
        (_LEFT - 5, base, "end", f"{y_range[0]:g}"),
        (_LEFT, HEIGHT - 5, "start", f"{x_range[0]:.3g}"),
        (WIDTH - 6, HEIGHT - 5, "end", f"{x_range[1]:.3g}"),
        (WIDTH / 2, HEIGHT - 5, "middle", axis),
    ]
    labels = "".join(
        f'<text x="{x:g}" y="{y:g}" text-anchor="{end}">{text}</text>' for x, y, end, text in texts
    )
    frame = f'<line class="axis" x1="{_LEFT}" x2="{WIDTH - 4}" y1="{base}" y2="{base}"/>'
    return (
        f'<svg class="chart" viewBox="0 0 {WIDTH} {HEIGHT}" data-left="{_LEFT}" data-width="{WIDTH - _LEFT - 4}" '
        f'role="img" aria-label="{label}">'
        f"{frame}{''.join(parts)}{labels}</svg>"
    )
