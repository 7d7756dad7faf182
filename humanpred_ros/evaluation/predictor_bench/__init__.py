"""How long one posture takes (`humanpred bench predictor`)."""
