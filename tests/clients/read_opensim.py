"""Run by an environment that has OpenSim: a TRC file to names, times, units and places, as JSON."""

import json
import sys

import opensim

table = opensim.TimeSeriesTableVec3(sys.argv[1])
names, times = list(table.getColumnLabels()), list(table.getIndependentColumn())
rows = []
for n in range(table.getNumRows()):
    row = table.getRowAtIndex(n)
    rows.append([[row[k][axis] for axis in range(3)] for k in range(len(names))])
print(json.dumps({"names": names, "times": times, "units": table.getTableMetaDataString("Units"), "places": rows}))
