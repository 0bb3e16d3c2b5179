"""Run by an environment that has OpenSim: a model and its motion; where its markers are in every row, as JSON."""

import json
import math
import sys

import opensim

model = opensim.Model(sys.argv[1])
state = model.initSystem()
table = opensim.TimeSeriesTable(sys.argv[2])
assert table.getTableMetaDataString("inDegrees") == "yes"
names = list(table.getColumnLabels())
coordinates = model.getCoordinateSet()
markers = model.getMarkerSet()
rows = []
for n in range(table.getNumRows()):
    row = table.getRowAtIndex(n)
    for k, name in enumerate(names):
        value = row[k] if name.startswith("pelvis_t") and len(name) == 9 else math.radians(row[k])
        coordinates.get(name).setValue(state, value, False)
    model.realizePosition(state)
    places = [markers.get(k).getLocationInGround(state) for k in range(markers.getSize())]
    rows.append([[place.get(axis) for axis in range(3)] for place in places])
marker_names = [markers.get(k).getName() for k in range(markers.getSize())]
mass = model.getTotalMass(state)
print(json.dumps({"names": marker_names, "times": list(table.getIndependentColumn()), "places": rows, "mass": mass}))
