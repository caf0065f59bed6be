"""The shipped configuration, and variations of its settings."""

from __future__ import annotations

import dataclasses

from ia_bench.common.paths import conf_folder

CONF = conf_folder()


def _variations(settings):
    """The same settings with one leaf changed, for every leaf but those that decide no number."""
    found = []
    for leaf in dataclasses.fields(settings):
        value = getattr(settings, leaf.name)
        if dataclasses.is_dataclass(value):
            found += [dataclasses.replace(settings, **{leaf.name: changed}) for changed in _variations(value)]
        elif leaf.name not in ("regularise", "regulariser_options"):  # numbers and texts
            other = value + "x" if isinstance(value, str) else not value if isinstance(value, bool) else value + 1
            found.append(dataclasses.replace(settings, **{leaf.name: other}))
    return found
