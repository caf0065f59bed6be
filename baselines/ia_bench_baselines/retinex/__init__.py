"""Colour Retinex: the oldest way to tell paint from light in one picture."""
