"""How sensitive `jcbb-hindsight` is to each of its constants: all are halved and doubled, one at a time.

`varying` knows the constants and changes them, `reading` which of them a run reads, `cases` the logs, `measure` the
runs, `rows` the CSV that an interrupted study goes on with, `cost` what is left to do, `table` the result.
"""
