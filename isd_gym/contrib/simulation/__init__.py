"""The command `isd-gym simulate`: outputs of a model for the inputs of a table, and its errors on measured outputs."""
