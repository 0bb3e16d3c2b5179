"""How everything here is fitted: `robust` (weights and scales), `gauss_newton`, `viterbi` (dynamic programming)."""
