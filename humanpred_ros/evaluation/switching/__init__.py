"""When the arm changes its goal, P1's Fig. 9 (`humanpred evaluate switching`)."""
