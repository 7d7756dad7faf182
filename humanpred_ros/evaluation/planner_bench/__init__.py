"""How long planning takes, beside a C++ floor and NumPy (`humanpred bench planner`)."""
