"""A small rigid-body engine, its adapter, and a scene."""
