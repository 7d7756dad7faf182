"""How early and surely motions are recognised (`humanpred evaluate recognition`)."""
