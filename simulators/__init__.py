"""The simulated cell: one physical truth behind servers that speak the real protocols.

Imports nothing of cellctl or drivers, so that no mistake can happen on both sides and cancel.
"""
