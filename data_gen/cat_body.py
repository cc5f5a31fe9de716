"""The cat at rest, as ``cat_body.toml`` tells it: the trunk and head together are about one unit long."""

import tomllib
from functools import cache
from pathlib import Path

from data_gen.body import Body, Bone, Cone

_TOLD = tomllib.loads(Path(__file__).with_name("cat_body.toml").read_text(encoding="utf-8"))


@cache
def cat_body() -> Body:
    """Both sides of the body."""
    bones = [Bone(name, parent or None, tuple(joint)) for name, parent, joint in _TOLD["bones"]]
    body = Body(_TOLD["blend"], bones, [[_cone(*told) for told in part] for part in _TOLD["parts"]])
    body.mirror()
    return body


def _cone(bone, start, end, first, last, scale=(1.0, 1.0, 1.0)):
    return Cone(bone, tuple(start), tuple(end), first, last, tuple(scale))
