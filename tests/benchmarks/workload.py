"""Spreads scenes over processes. Every process uses one thread of OpenCV, and builds its detectors once."""

from __future__ import annotations

import multiprocessing
from collections.abc import Callable, Iterable
from concurrent.futures import ProcessPoolExecutor
from typing import TypeVar

import cv2

T = TypeVar("T")
SEEDS_A_BATCH = 4


def one_thread() -> None:
    """Let OpenCV use one thread: what is compared is work, not how well it is spread."""
    cv2.setNumThreads(1)


def over_seeds(work: Callable[[int], list[T]], seeds: Iterable[int], workers: int) -> list[T]:
    """Do some work for each seed.

    Args:
        work: A function of a module, from a seed to results.
        seeds: The scenes.
        workers: How many processes; 1 for none but this one.

    Returns:
        The results, in the order of the seeds.
    """
    one_thread()
    if workers == 1:
        return [result for seed in seeds for result in work(seed)]
    # A forked copy of a process in which OpenCV has had threads may hang; new processes cannot.
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(workers, context, one_thread) as pool:
        batches = pool.map(work, seeds, chunksize=SEEDS_A_BATCH)
        return [result for batch in batches for result in batch]
