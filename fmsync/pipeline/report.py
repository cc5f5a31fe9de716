"""One self-contained page: what was found, in plain words and turnable pictures."""

import html

import numpy as np
import pandas as pd

from fmsync import viz
from fmsync.pipeline.synchronise import SyncedShapes

_MOST = 6  # shapes shown in a scene
_PAGE = """<!doctype html>
<html lang="en"><head><meta charset="utf-8"><meta name="viewport" content="width=device-width">
<title>Correspondences of {count} shapes</title>
<style>
body {{ font: 16px/1.5 system-ui, sans-serif; max-width: 60rem; margin: 2rem auto; padding: 0 1rem; color: #1a1a1a }}
table {{ border-collapse: collapse; font-variant-numeric: tabular-nums }}
td, th {{ padding: .15rem .7rem; text-align: right; border-bottom: 1px solid #ddd }}
td:first-child, th:first-child, td:nth-child(2), th:nth-child(2) {{ text-align: left }}
.fm-titles span {{ font-size: .9rem }} .wide {{ overflow-x: auto }}
</style></head><body>
<h1>Correspondences of {count} shapes</h1>
{summary}
<h2>Colours carried from {reference}</h2>
<p>Every vertex has the colour of its image on {reference}. Drag to turn.</p>
{colours}
<h2>Where not to believe them</h2>
<p>Radius of the region that holds {level:.0%} of the posterior draws of a vertex's image, plus the mean distance to
where maps through other shapes send it, in units of the square root of the surface area.</p>
{unsure}
<h2>Every pair</h2>
<p>Distortion: mean change of geodesic distances. Orientation: 1 keeps left and right, -1 swaps them. Believed: how far
the pair counted in the robust synchronisation.</p>
<div class="wide">{edges}</div>
</body></html>
"""


def report(
    synced: SyncedShapes, tables: dict[int, pd.DataFrame], edges: pd.DataFrame, reference: int, level: float
) -> str:
    """HTML of the report; ``tables`` holds the vertex table of every shape but the reference."""
    shapes = [s.shape for s in synced.shapes]
    shown = [k for k in [reference, *tables][:_MOST] if shapes[k].faces is not None]
    colours = unsure = "<p>Point clouds are not drawn: open the files in <code>meshes</code>.</p>"
    if reference in shown and len(shown) > 1:
        own = viz.colours_from_coordinates(shapes[reference].vertices)
        carried = [own if k == reference else own[tables[k]["image"]] for k in shown]
        alt = f"Colours of {shapes[reference].name} carried to {len(shown) - 1} other shapes."
        colours = _drawn([shapes[k] for k in shown], carried, alt=alt)
        others = shown[1:]
        total = [(tables[k]["radius"] + tables[k]["spread"]).to_numpy() for k in others]
        top = float(np.quantile(np.concatenate(total), 0.98))
        alt = "Uncertainty of every vertex's image: bright where correspondences should not be believed."
        unsure = _drawn([shapes[k] for k in others], total, alt=alt, clim=(0.0, top), label="√area", flat=True)
    return _PAGE.format(
        count=len(shapes),
        summary=_summary(synced, tables, edges, level),
        reference=html.escape(shapes[reference].name),
        colours=colours,
        unsure=unsure,
        level=level,
        edges=edges.to_html(index=False, float_format="%.3g", border=0),
    )


def _drawn(shapes, scalars, **options) -> str:
    return viz.scene(shapes, scalars, columns=3, **options)._repr_mimebundle_()["text/html"]


def _summary(synced, tables, edges, level) -> str:
    radius = np.concatenate([t["radius"] for t in tables.values()])
    double = float(np.mean(np.concatenate([t["two_modes"] for t in tables.values()])))
    doubted = edges[edges["believed"] < 0.5]
    worst = max(tables, key=lambda k: float(np.median(tables[k]["radius"] + tables[k]["spread"])))
    said = [
        f"{len(synced.shapes)} shapes were matched in {len(edges)} pairs from their geometry alone.",
        f"Half of all vertices have a {level:.0%} region of radius below {np.median(radius):.3f}, nine in ten below "
        f"{np.quantile(radius, 0.9):.3f} (a whole shape has area 1).",
        f"{double:.1%} of the vertices have two candidate places, usually the left and the right of a symmetric part.",
        f"{len(doubted)} pairs were given up because the others contradict them"
        + (": " + ", ".join(f"{a}–{b}" for a, b in zip(doubted["first"], doubted["second"])) if len(doubted) else "")
        + ".",
        f"Least certain of all shapes: {synced.names[worst]}.",
    ]
    if len(synced.violating):
        said.append(f"{len(synced.violating)} pairs disagree with the signs of the rest (last column of the table).")
    return "<ul>" + "".join(f"<li>{html.escape(line)}</li>" for line in said) + "</ul>"
