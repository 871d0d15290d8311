"""What is kept is limited in bytes, not in number."""

from physkin_core.loader.kept import Kept


def test_what_was_used_longest_ago_goes_first():
    kept = Kept(100)
    for key, size in (("a", 40), ("b", 40)):
        kept.keep(key, key.upper(), size)
    assert kept.get("a") == "A"
    kept.keep("c", "C", 30)
    assert (kept.get("a"), kept.get("b"), kept.get("c"), kept.size) == ("A", None, "C", 70)


def test_what_is_larger_than_all_is_not_kept():
    kept = Kept(100)
    kept.keep("a", "A", 40)
    kept.keep("b", "B", 101)
    assert (kept.get("b"), kept.size) == (None, 0)
