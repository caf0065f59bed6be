"""Every file of weights has a card that says what the field asks of one, with the file's size and SHA-256."""

import hashlib
import re
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
WEIGHTS = sorted(path for part in ("ia_bench", "baselines", "training") for path in (ROOT / part).rglob("*.safetensors"))
ASKED = ("data", "licence", "meant for", "limits")
ROW = re.compile(r"^\| `([^`]+)` \| (\d+) \| `([0-9a-f]{64})` \|$", re.MULTILINE)


def card_of(weights: Path) -> Path | None:
    """The card beside a file, or of the nearest folder above it that has one."""
    folders = [folder for folder in weights.parents if folder.is_relative_to(ROOT) and folder != ROOT]
    return next(
        (folder / name for folder in folders for name in ("CARD.md", "card.md", "README.md") if (folder / name).exists()), None
    )


CARDS = sorted({card for path in WEIGHTS if (card := card_of(path)) is not None})


@pytest.mark.parametrize("path", WEIGHTS, ids=lambda path: str(path.relative_to(ROOT)))
def test_weights_have_a_card_with_their_hash(path: Path) -> None:
    card = card_of(path)
    content = path.read_bytes()
    row = (path.relative_to(card.parent).as_posix(), str(len(content)), hashlib.sha256(content).hexdigest())
    assert row in ROW.findall(card.read_text(encoding="utf-8")), f"{card}: expected the row | `{row[0]}` | {row[1]} | `{row[2]}` |"


@pytest.mark.parametrize("card", CARDS, ids=lambda path: str(path.relative_to(ROOT)))
def test_a_card_says_what_is_asked_of_one(card: Path) -> None:
    text = card.read_text(encoding="utf-8")
    assert not [asked for asked in ASKED if not re.search(rf"^\| {asked} \| \S", text, re.MULTILINE)]
    assert not [name for name, _, _ in ROW.findall(text) if not (card.parent / name).is_file()]
