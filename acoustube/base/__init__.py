"""Common base of all packages: errors, rules, files, the cache, surfaces, the console.

Reading order: `units`, `types`, `errors`, `rules` (of settings), `checks` (of arguments), `names`,
`limits` (of the model), `sampling`; `foreign` (files of other programs), `surfaces`, `writing`,
`files`, `netcdf` and `cache` (our files), `remnants` (incomplete ones); `report` and `console`
(messages and progress), `interrupts`; `compilation` and `ahead` (of numerical code),
`small_systems` (in JAX); `moved` (former addresses) and `version`.
"""
