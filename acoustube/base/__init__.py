"""Common base of all packages: errors, rules, files, the cache, surfaces, the console.

`rules` are those of settings, `checks` those of arguments, `limits` those of the model; `foreign`
reads other programs' files, `writing` and `files` write ours, `report` and `console` print.
"""
