"""From posture to trajectory over DDS (`humanpred bench graph`)."""
