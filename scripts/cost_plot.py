#!/usr/bin/env python3
"""Measures the cost of a training step over splats and image sizes, and draws docs/src/images/cost.svg.

    cargo build --release
    scripts/cost_plot.py target/release/luxel measure cost.json      # minutes; leave the machine idle
    scripts/cost_plot.py draw cost.json docs/src/images/cost.svg

`measure` runs `luxel bench --generate` over the grid. `draw` also prints the table for docs/src/notebook/performance-cost.md: milliseconds of a step, and what is left of
them after the least-squares fit of  a + b splats + c evaluations  (all three at least 0).
"""

import json
import math
import subprocess
import sys

SPLATS = [10_000, 30_000, 100_000, 300_000, 1_000_000]
SIDES_PX = [200, 400, 800, 1600]
STEPS = 9


def measure(luxel, out):
    results = []
    for splats in SPLATS:
        for side in SIDES_PX:
            command = [luxel, "bench", "--generate", str(splats), "--size", f"{side}x{side}", "--steps", str(STEPS), "--json"]
            run = subprocess.run(command, check=True, capture_output=True, text=True)
            results.append(json.loads(run.stdout))
            print(splats, side, results[-1]["step_ms"]["median"], file=sys.stderr)
    with open(out, "w", encoding="utf-8") as file:
        json.dump(results, file, indent=1)


def fit(rows):
    """Non-negative least squares of relative errors by trying every subset of the three terms."""
    best = None
    for subset in range(1, 8):
        terms = [i for i in range(3) if subset >> i & 1]
        design = [[(1.0, row["splats"] / 1e6, row["evaluations"] / 1e6)[i] / row["ms"] for i in terms] for row in rows]
        n = len(terms)
        normal = [[sum(r[i] * r[j] for r in design) for j in range(n)] + [sum(r[i] for r in design)] for i in range(n)]
        for i in range(n):
            pivot = normal[i][i]
            normal[i] = [value / pivot for value in normal[i]]
            for j in range(n):
                if j != i:
                    normal[j] = [a - normal[j][i] * b for a, b in zip(normal[j], normal[i])]
        solution = [0.0, 0.0, 0.0]
        for i, term in enumerate(terms):
            solution[term] = normal[i][n]
        error = sum((1 - sum(d * solution[t] for d, t in zip(r, terms))) ** 2 for r in design)
        if min(solution) >= 0 and (best is None or error < best[0]):
            best = (error, solution)
    return best[1]


def draw(results, out):
    rows = []
    for result in results:
        splats, side = result["splats"], result["width"]
        rows.append({"splats": splats, "side": side, "ms": result["step_ms"]["median"], "evaluations": result["evaluations"]["touched"]})
    fixed, per_splat, per_evaluation = fit(rows)
    print(f"fit: {fixed:.2f} ms + {per_splat:.1f} ns a splat + {per_evaluation:.3f} ns an evaluation\n")
    print("| splats | image | evaluations, millions | step, ms | of the fit |\n|---|---|---|---|---|")
    for row in rows:
        model = fixed + per_splat * row["splats"] / 1e6 + per_evaluation * row["evaluations"] / 1e6
        print(f"| {row['splats']:,} | {row['side']}x{row['side']} | {row['evaluations'] / 1e6:.1f} | {row['ms']:.1f} | {row['ms'] / model:.2f} |")
    with open(out, "w", encoding="utf-8") as file:
        file.write(svg(rows))


def svg(rows):
    width, height, left, right, top, bottom = 720, 420, 70, 30, 30, 60
    low_ms, high_ms = 1.0, 10 ** math.ceil(math.log10(max(row["ms"] for row in rows)))

    def x(splats):
        return left + (width - left - right) * math.log10(splats / SPLATS[0]) / math.log10(SPLATS[-1] / SPLATS[0])

    def y(ms):
        return height - bottom - (height - top - bottom) * math.log10(ms / low_ms) / math.log10(high_ms / low_ms)

    parts = [
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width} {height}" font-family="sans-serif" font-size="13">',
        f'<rect width="{width}" height="{height}" fill="#fff"/>',
        f'<text x="{left}" y="18">Training step, milliseconds on two cores, over splats and image size</text>',
    ]
    for decade in range(int(math.log10(high_ms)) + 1):
        ms = 10**decade
        parts.append(f'<line x1="{left}" x2="{width - right}" y1="{y(ms):.1f}" y2="{y(ms):.1f}" stroke="#ddd"/>')
        parts.append(f'<text x="{left - 8}" y="{y(ms) + 4:.1f}" text-anchor="end">{ms}</text>')
    for splats in SPLATS:
        label = f"{splats // 1000}k" if splats < 1_000_000 else f"{splats // 1_000_000}M"
        parts.append(f'<text x="{x(splats):.1f}" y="{height - bottom + 20}" text-anchor="middle">{label}</text>')
    parts.append(f'<text x="{(left + width - right) / 2}" y="{height - 16}" text-anchor="middle">splats</text>')
    # A line of slope one: cost in proportion to splats.
    ends = [(SPLATS[0], 2.0), (SPLATS[-1], 2.0 * SPLATS[-1] / SPLATS[0])]
    parts.append('<polyline fill="none" stroke="#999" stroke-dasharray="5 4" points="' + " ".join(f"{x(a):.1f},{y(b):.1f}" for a, b in ends) + '"/>')
    parts.append(f'<text x="{x(ends[0][0]) + 8:.1f}" y="{y(ends[0][1]) + 14:.1f}" fill="#777">in proportion to splats</text>')
    for side, color in zip(SIDES_PX, ["#1b6ca8", "#2a9d4a", "#d98a00", "#b8322a"]):
        line = [row for row in rows if row["side"] == side]
        parts.append(f'<polyline fill="none" stroke="{color}" stroke-width="2" points="' + " ".join(f"{x(row['splats']):.1f},{y(row['ms']):.1f}" for row in line) + '"/>')
        parts += [f'<circle cx="{x(row["splats"]):.1f}" cy="{y(row["ms"]):.1f}" r="3.5" fill="{color}"/>' for row in line]
        parts.append(f'<text x="{x(line[0]["splats"]) + 8:.1f}" y="{y(line[0]["ms"]) - 8:.1f}" fill="{color}">{side} x {side} px</text>')
    return "\n".join([*parts, "</svg>\n"])


def main():
    if len(sys.argv) == 4 and sys.argv[2] == "measure":
        measure(sys.argv[1], sys.argv[3])
    elif len(sys.argv) == 4 and sys.argv[1] == "draw":
        with open(sys.argv[2], encoding="utf-8") as file:
            draw(json.load(file), sys.argv[3])
    else:
        sys.exit(__doc__)


if __name__ == "__main__":
    main()
