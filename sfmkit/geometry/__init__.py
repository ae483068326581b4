"""The mathematics of two views: pure torch functions on tensors ``(*B, N, 2)``, batched and
differentiable."""
