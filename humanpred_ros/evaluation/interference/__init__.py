"""How much the arm disturbs the person, P1's Table I (`humanpred evaluate interference`)."""
