"""What is followed over many units: drift of the placements, focus and light of the pictures."""
