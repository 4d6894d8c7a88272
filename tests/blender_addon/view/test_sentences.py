"""Sentences fit into any width."""

from __future__ import annotations

import pytest

pytest.importorskip("bpy", exc_type=ImportError)

from blender_addon.view.sentences import lines

TEXT = "Nothing hides voxels A, B and C from 'Camera', see /home/somebody/a/very/long/folder/of/theirs/room.blend"


@pytest.mark.parametrize("room", [1.0, 4.0, 10.0, 33.0, 1000.0])
def test_no_line_is_wider_than_there_is_room_and_nothing_is_lost(room: float) -> None:
    found = lines(TEXT, room, lambda words: float(len(words)))
    assert max(map(len, found)) <= room
    assert "".join(found).replace(" ", "") == TEXT.replace(" ", "")


def test_words_are_cut_only_where_they_do_not_fit() -> None:
    assert lines("one two three", 7.0, len) == ["one two", "three"]
    assert lines("a abcdefgh", 4.0, len) == ["a", "abcd", "efgh"]
    assert lines("", 4.0, len) == [""]
