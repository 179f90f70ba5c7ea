"""Contexts in which a toy is registered."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

from track_range.ranging import registry
from track_range.ranging.methods.method import RangingMethod
from track_range.results.writers import WRITERS, WriterFactory, register_writer


@contextmanager
def registered_method(method: RangingMethod) -> Iterator[None]:
    """Context in which a ranging method is registered."""
    with registry.METHODS.restored():
        registry.register(method)
        yield


@contextmanager
def registered_writer(name: str, factory: WriterFactory | str) -> Iterator[None]:
    """Context in which a result writer is registered."""
    with WRITERS.restored():
        register_writer(name, factory)
        yield
