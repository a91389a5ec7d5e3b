"""Policies beyond the paper; the README says what each is worth."""
