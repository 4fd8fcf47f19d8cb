"""Madrona: a simulator module that the user builds; docs/madrona.md is the contract with it."""
