"""Find the destinations of a stream from the options that ``stream`` and ``live`` share."""

from __future__ import annotations

import argparse

from ..livelink.packet import PORT as LIVELINK_PORT
from .stream import OSC_PORT, VMC_PORT, Address, Sender, check_streaming

_KINDS = (("VMC", "vmc", VMC_PORT), ("OSC", "osc", OSC_PORT), ("Live Link Face", "livelink", LIVELINK_PORT))


def addresses(args: argparse.Namespace, default_vmc: bool = False) -> dict[str, Address]:
    """The addresses that the options name, by "vmc", "osc" and "livelink".

    Parameters
    ----------
    args : argparse.Namespace
        The options.
    default_vmc : bool
        Whether to send VMC to this machine if no option names a destination.

    Raises
    ------
    ParameterError
        An address is malformed.
    MissingExtraError
        python-osc is needed, and not installed.
    """
    found = {
        name: Address.parse(getattr(args, name), port) for _, name, port in _KINDS if getattr(args, name, None) is not None
    }
    if default_vmc and not found:
        found["vmc"] = Address.parse("", VMC_PORT)
    if {"vmc", "osc"} & set(found):
        check_streaming()
    return found


def avatar(args: argparse.Namespace):
    """The :class:`~adaptiveface.export.messages.VmcAvatar` of ``--vmc-avatar`` and ``--vmc-root``."""
    from .messages import VmcAvatar, read_avatar

    path, moves = getattr(args, "vmc_avatar", None), getattr(args, "vmc_root", False)
    return VmcAvatar(moves=moves) if path is None else read_avatar(path, moves)


def said(found: dict[str, Address]) -> list[str]:
    """One line for each destination."""
    return [f"{kind} to {found[name].host}:{found[name].port}" for kind, name, _ in _KINDS if name in found]


def destinations(args: argparse.Namespace) -> tuple[Sender | None, list[str]]:
    """The sender that the options ask for, or None, and one line about each destination."""
    found = addresses(args)
    return (Sender(**found, avatar=avatar(args)) if found else None), said(found)
