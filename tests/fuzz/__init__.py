"""Fuzzer of the commands and the public functions, by mutated inputs of every kind."""
