"""Identification from contact-free frames alone."""

import bubbleviz as bv


def identify(source, sensor, frames=None, **settings):
    return bv.identify(source, sensor, contact_free=frames, held_press=False, **settings).found
