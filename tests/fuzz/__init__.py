"""Fuzzer of the commands and the public functions: mutated inputs of every kind, in masses."""
