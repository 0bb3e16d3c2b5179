"""Solvers that everything here is fitted by: `robust` (weights and scales), `gauss_newton`, `viterbi` (dynamic
programming)."""
