"""Labelled images on disk: writing, checking, reading. No Drake in here."""
