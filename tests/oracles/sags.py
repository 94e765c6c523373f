"""Sag of links: distance of the centreline from the chord between its ends."""

import numpy as np

import flexman_gym as fm


def largest_sag(episode):
    """Return the largest sag of a link of an episode, as a fraction of its length."""
    points = fm.curves(episode.model, episode.states, 9).positions
    chord = points[:, :, -1] - points[:, :, 0]
    across = np.linalg.norm(np.cross(points - points[:, :, :1], chord[:, :, None]), axis=-1)
    sags = across / np.linalg.norm(chord, axis=-1)[..., None]
    return (sags / episode.model.constants.length[:, None]).max()
