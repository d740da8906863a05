"""Common base of all packages: errors, rules, files, the cache, surfaces, the console.

Reading order: `units`, `types`, `errors`, `rules` (of settings), `checks` (of arguments), `names`,
`limits` (of the model), `sampling`; `foreign` (files of other programs), `surfaces`, `writing`,
`files`, `netcdf`, `netcdf_reader` and `cache` (our files), `remnants` (incomplete outputs);
`report` and `console` (messages and progress), `interrupts`; `compilation` (its options) and
`ahead` (in a thread), `small_systems` (of linear equations); `moved` (former addresses) and
`version`.
"""
