"""Ground that every package stands on: errors, rules, files, the cache, surfaces, the console."""
