"""What an estimator expects to see, and the decisions made from it: pure functions, no filter, no smoother."""
