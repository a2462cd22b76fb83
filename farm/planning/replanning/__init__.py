"""Replanning of waiting plates: policy (which), coordinator (when), worker (how)."""
