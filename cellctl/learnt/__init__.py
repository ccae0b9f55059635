"""What the cell has learnt about itself, in sealed files: calibrations, golden assemblies, doubts about them."""
