"""Shipped examples: each writes surfaces and a scene into a folder."""
