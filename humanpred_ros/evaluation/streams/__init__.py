"""Onsets, ends and recognition on long streams (`humanpred evaluate streams`)."""
