"""From episode rows to tables, verdicts and paired differences. Pure: reads and writes no file.

| module | what it has |
|---|---|
| `rows` | `EpisodeRow`, `OverallRow`, `Results` |
| `summary` | `summarize`: rows to success rates; `results_document`, `parse_results` |
| `tables` | `table`: success rates for people |
| `comparison` | `compare`: two evaluations on the scenarios that they share |
| `paper` | the success rates of the paper: Table 1 and its ablations |
| `requirements` | `parse_requirement`, `check`: bounds of `--require` |
| `paper` | `paper_success`: the paper's success rates |
| `statistics` | Wilson, Newcombe, McNemar and Student intervals and tests |
"""
