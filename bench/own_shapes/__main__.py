"""How far the pipeline for own shapes can be trusted, on collections with one vertex order.

The order serves for evaluation, never for maps. Each part is a command, and adds to one file of results:

* ``python -m bench.own_shapes collections tosca_cat cats``: errors and CPU seconds of the stages, for the first
  collection beside pyFM; coverage of regions as they come, and calibrated on the other collection; errors of the
  vertices that are retained.
* ``... planted cats``: coverage where the model is right; ``... likelihoods cats creatures tosca_cat``: do
  concentrations by edge or frequency rank vertices better; ``... given tosca_cat``: what synchronisation makes of
  pyFM's maps, right and spoiled, on these and on random species.
* ``python -m bench.own_shapes species``: coverage over random species, of which nothing else is read; ``... refit --out
  fmsync/matching/conformal.json``: the calibration that the package ships, fitted on these species; ``... outliers``:
  how many shapes that do not belong to a folder are found, and how many others are named; ``... matching``: errors
  beside pyFM and the bound, regions by part of the body and rates of warnings, on species in four variants.

A collection is a folder, the name of one in FMSYNC_DATA, or ``cats``. Lengths are in square roots of the area.
"""

import argparse
from pathlib import Path

from bench.own_shapes import confidence, given, matching, outliers, species
from bench.studies import add_part
from data_gen import load_collection

PARTS = {
    "collections": confidence.collections,
    "planted": confidence.planted,
    "likelihoods": confidence.likelihoods,
    "given": given.table,
}
_KEPT = Path("_build/species")  # points of finished species
_MAKES = {
    "species": lambda: species.table(_KEPT),
    "outliers": lambda: outliers.table(_KEPT.with_name("outliers")),
    "matching": lambda: matching.table(_KEPT.with_name("matching")),
}


def main(arguments: list[str] | None = None) -> None:
    """Measure one part and add it to the file of results."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("part", choices=[*PARTS, *_MAKES, "refit"])
    parser.add_argument("collections", nargs="*")
    parser.add_argument("--out", type=Path, default=Path("results/own_shapes.json"))
    options = parser.parse_args(arguments)
    command = " ".join(["python -m bench.own_shapes", options.part, *(Path(name).name for name in options.collections)])
    if (options.part in PARTS) != bool(options.collections):
        parser.error(f"collections: {options.part} reads {'at least one' if options.part in PARTS else 'none'}")
    if options.part == "refit":
        species.fitted(species.all_points(species.FIT, _KEPT)).save(options.out)
        return
    coarse = {"cats": {"n_vertices": 4000}}
    loaded = {Path(name).name: load_collection(name, **coarse.get(name, {})) for name in options.collections}
    found = PARTS[options.part](loaded) if loaded else _MAKES[options.part]()
    add_part(options.out, options.part, found, command)


if __name__ == "__main__":
    main()
