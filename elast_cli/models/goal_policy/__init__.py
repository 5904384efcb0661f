"""Goal-conditioned policies: an action from the state and the goal, without a plan."""
