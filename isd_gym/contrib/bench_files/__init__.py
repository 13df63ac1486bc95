"""Files of test benches beside CSV, Parquet, MATLAB and MDF: LabVIEW (.lvm, .tdms), universal files, Excel, MATLAB 7.3.

`entry` announces the formats to `isd_gym.records.data`. The other modules read one format each; all but `lvm` run in the
process of `isd_gym.records._formats.host`, so this module imports nothing.
"""
