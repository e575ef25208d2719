"""What a script says of itself on `script/event`: for who says it, and who reads it in a bag."""

from __future__ import annotations

SCRIPTED = (
    "closure", "continue", "cut", "grab", "label", "let_go", "model", "move", "over", "patch",
    "pause", "press", "redo", "release", "reset", "sew_rim", "suture", "tighten", "undo",
    "unsuture", "use",
)  # fmt: skip
"""First words of what it does, and of its end; anything else is a label."""
