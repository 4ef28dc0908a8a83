"""Work on several cores gives the same bits, and a wrong number of threads one sentence."""

from __future__ import annotations

import threading
import time

import numpy as np
import pytest
from threadpoolctl import ThreadpoolController

import albedo
from albedo._threads import _at_work, blas_in_one, by_weight, in_batches, side_by_side, threads
from albedo.charts.heights import (
    FIRST,
    LAST,
    LOWEST,
    elevation_at,
    fold,
    fold_elevation,
    fold_elevations,
    folded,
    log_height,
    unfolded,
)
from albedo.errors import InputError
from albedo.operators.ladder import Ladder


@pytest.mark.parametrize("control", [None, "cumulative"])
def test_curves_have_the_same_bits(control: str | None, monkeypatch: pytest.MonkeyPatch) -> None:
    """More rows than one batch has, and more slices than are left to one thread."""
    found = []
    for count in ("1", "3"):
        monkeypatch.setenv("ALBEDO_THREADS", count)
        ladder = Ladder(albedo.model("ward", m=0.2), control, 1.2e-10)
        for _ in range(4):
            ladder.step()
        found.append(ladder)
    one, three = found
    assert one._cos.size > 64
    assert one._parts[0].slices.panel.size > 1000
    for a, b in zip(one.curves, three.curves, strict=True):
        np.testing.assert_array_equal(a.edges, b.edges)
        np.testing.assert_array_equal(a.coefficients, b.coefficients)
        np.testing.assert_array_equal(a.error, b.error)


def test_products_of_matrices_get_their_threads_back() -> None:
    """Whoever leaves last gives them back, and nobody keeps the limit that another set."""
    # Integration may load one more library, which is to be there from the beginning.
    import scipy.linalg  # noqa: F401

    blas = ThreadpoolController().select(user_api="blas")
    entered, left = threading.Event(), threading.Event()

    def counts() -> set[int]:
        return {library["num_threads"] for library in blas.info()}

    def work() -> None:
        with blas_in_one:
            entered.set()
            assert left.wait(60.0)

    before = counts()
    with blas.limit(limits=3):
        other = threading.Thread(target=work)
        with blas_in_one, blas_in_one:
            assert counts() == {1}
            other.start()
            assert entered.wait(60.0)
        left.set()
        other.join()
        assert counts() == {3}
        with pytest.raises(ZeroDivisionError), blas_in_one:
            raise ZeroDivisionError
        assert counts() == {3}
    assert counts() == before


def test_parts_come_in_order_and_cover_all(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("ALBEDO_THREADS", "3")
    items = np.arange(1000)
    for found in (
        side_by_side(lambda part: items[part], items.size, 10),
        in_batches(lambda part: items[part], items.size, 64),
    ):
        assert len(found) > 1
        np.testing.assert_array_equal(np.concatenate(found), items)
    weight = np.arange(1000) % 7
    found = by_weight(lambda part: items[part], weight, 100.0)
    np.testing.assert_array_equal(np.concatenate(found), items)
    shares = [weight[part].sum() for part in found]
    # No two of them differ by more than an item.
    assert len(found) == 9
    assert max(shares) - min(shares) <= 2 * weight.max()
    # One item that outweighs all others is a part of its own.
    heavy = by_weight(lambda part: items[part], np.where(items == 500, 1e6, 1.0), 1.0)
    np.testing.assert_array_equal(np.concatenate(heavy), items)
    assert [part.size for part in by_weight(lambda part: items[part], np.empty(0), 1.0)] == [0]
    # Nothing at all is one empty part.
    assert [part.size for part in in_batches(lambda part: items[part], 0, 64)] == [0]
    assert [part.size for part in side_by_side(lambda part: items[part], 0, 10)] == [0]


@pytest.mark.parametrize(("count", "parts"), [(599, 1), (600, 2), (4800, 5), (60_000, 16)])
def test_more_threads_are_woken_up_as_the_root_of_the_work(
    count: int, parts: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("ALBEDO_THREADS", "16")
    assert len(side_by_side(lambda part: part, count, 300)) == parts
    # Some more parts than threads.
    found = by_weight(lambda part: part, np.ones(count), 300.0)
    assert len(found) == max(min(3 * parts, count // 300), 1)


def test_work_inside_work_does_not_wait_for_itself(monkeypatch: pytest.MonkeyPatch) -> None:
    """All threads of the pool are taken by what waits for more."""
    monkeypatch.setenv("ALBEDO_THREADS", "2")

    def outer(part: slice) -> int:
        return sum(in_batches(lambda inner: inner.stop - inner.start, part.stop - part.start, 2))

    found: list[list[int]] = []
    waiting = threading.Thread(target=lambda: found.append(in_batches(outer, 64, 8)), daemon=True)
    waiting.start()
    waiting.join(30.0)
    assert found == [[8] * 8]


def test_who_waits_makes_room_for_others(monkeypatch: pytest.MonkeyPatch) -> None:
    """What one thread is left with is shared as soon as the other has nothing to begin."""
    monkeypatch.setenv("ALBEDO_THREADS", "2")
    workers: list[set[int]] = [set(), set()]
    busy, most = 0, 0
    lock = threading.Lock()

    def inner(_: slice) -> None:
        nonlocal busy, most
        with lock:
            busy += 1
            most = max(most, busy)
        time.sleep(0.002)
        with lock:
            busy -= 1
        workers[1].add(threading.get_ident())

    def outer(part: slice) -> None:
        workers[0].add(threading.get_ident())
        if part.start == 1:
            in_batches(inner, 200, 1)

    in_batches(outer, 2, 1)
    assert len(workers[1]) == 2
    # And never more than two work at once.
    assert most == 2


@pytest.mark.parametrize("where", [0, 5])
def test_what_fails_begins_nothing_more_and_leaves_all_the_room(
    where: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("ALBEDO_THREADS", "2")
    begun: list[int] = []

    def work(part: slice) -> None:
        begun.append(part.start)
        if part.start == where:
            raise ZeroDivisionError
        time.sleep(0.002)

    with pytest.raises(ZeroDivisionError):
        in_batches(work, 400, 1)
    assert len(begun) < 400
    assert _at_work._count == 0
    # As many as before, and all of it.
    assert in_batches(lambda part: part.start, 50, 1) == list(range(50))


@pytest.mark.parametrize("chosen", ["0", "257", "two", "-1", "1.5"])
def test_a_wrong_number_gets_one_sentence(chosen: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("ALBEDO_THREADS", chosen)
    with pytest.raises(InputError, match=r"ALBEDO_THREADS = '.*' is out of range; .* \[1, 256\]"):
        threads()


def test_heights_of_elevations_are_those_of_cosines() -> None:
    e = np.concatenate((np.geomspace(LOWEST, 1e-3, 40), np.linspace(1e-3, 0.5 * np.pi, 60)))
    y = np.array([fold_elevation(x) for x in e])
    direct = np.array([fold(np.sin(x), np.cos(x)) for x in e])
    # Both round a logarithm below 44.4, or an angle.
    np.testing.assert_allclose(y, direct, rtol=0.0, atol=2e-14)
    # An ulp of y moves a small elevation by as many as y is large.
    np.testing.assert_allclose([elevation_at(x) for x in y], e, rtol=2e-14, atol=0.0)
    line = np.linspace(FIRST, LAST, 101)
    np.testing.assert_allclose(
        [log_height(x) for x in line], np.log(unfolded(line)), rtol=1e-14, atol=1e-15
    )
    many = np.empty(e.size + 1)
    fold_elevations(np.append(0.0, e), many)
    # Logarithms are rounded, and one of them is that of a sine that is.
    np.testing.assert_allclose(many[1:], y, rtol=2.0**-51, atol=2.0**-53)
    assert many[0] == fold_elevation(0.0) == pytest.approx(FIRST, rel=2.0**-52)
    assert log_height(folded(np.array([LOWEST]))[0]) == pytest.approx(np.log(LOWEST), rel=1e-15)
