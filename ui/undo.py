"""Undo: a setting goes from one value to another and back, whatever it is a setting of."""

from __future__ import annotations

from collections.abc import Callable, Hashable
from typing import Generic, TypeVar

from PySide6.QtGui import QUndoCommand

T = TypeVar("T")

_MERGEABLE = 1  # what Qt asks by before it offers two commands to `mergeWith`


class Change(QUndoCommand, Generic[T]):
    """A value that changes from `old` to `new`.

    Parameters
    ----------
    text : str
        What the Edit menu calls it.
    apply : callable
        Makes a value the present one.
    old, new
        Values, immutable.
    gesture : hashable, optional
        Changes of one gesture (a slider that is dragged) are undone as one.
    """

    def __init__(
        self,
        text: str,
        apply: Callable[[T], None],
        old: T,
        new: T,
        gesture: Hashable = None,
    ) -> None:
        super().__init__(text)
        self.apply, self.old, self.new, self.gesture = apply, old, new, gesture

    def id(self) -> int:
        """Same for all that may be merged."""
        return -1 if self.gesture is None else _MERGEABLE

    def mergeWith(self, other: QUndoCommand) -> bool:
        """Take over what a later change of the same gesture leads to."""
        if not isinstance(other, Change) or other.gesture != self.gesture:
            return False
        self.new = other.new
        return True

    def undo(self) -> None:
        """Go back."""
        self.apply(self.old)

    def redo(self) -> None:
        """Do it, for the first time or again."""
        self.apply(self.new)
