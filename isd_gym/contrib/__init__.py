"""Wings of the house: parts beside the mission, each in a folder of its own.

`bench_files` (files of LabVIEW, DIAdem, Excel and MATLAB 7.3, universal files), `ceilings` (bounds and least known
costs), `exports` (archives of Stable-Baselines3, plain C, ONNX), `films` (recorders of episodes), `fleet` (a
diagnosis for each of many cases), `fmi` (functional mock-up units), `hub` (a folder for a model hub), `inspection`
(content of loggers' files, and which column is which channel), `minari` (data sets), `no_road` (identification
without a measured road), `own_controllers` (controllers of a user's Python file), `reproduce` (figures of the paper;
it shows the ceilings), `simulation` (`isd-gym simulate`: outputs of a model for a table, and its errors on measured
ones), `sweep` (grids of conditions), `training` (`isd-gym train`, which made the shipped policies), `warming`
(compilation before its time), `wrappers` (the options for learning, for environments of other packages). `actors`
makes policies of the weights of Stable-Baselines3 for `exports` and `training`, `engine` runs the many independent
cases of `fleet` and `sweep` on cores and clusters; `progress` shows how far they are, `markdown` and `records` serve
several wings.

The core reaches a wing by an entry point (`isd_gym._common.plugins`). No wing imports another, but `reproduce` the ceilings.
"""
