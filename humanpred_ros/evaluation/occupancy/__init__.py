"""How well the space a body is going to sweep is predicted (`humanpred evaluate occupancy`)."""
