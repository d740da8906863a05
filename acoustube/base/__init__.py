"""Common base of all packages: errors, rules, files, the cache, surfaces, the console."""
