"""Preparation of pictures before learning: sensor model, features, tables of features."""
