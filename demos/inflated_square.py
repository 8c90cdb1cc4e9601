"""A cable tightened over an inflated square membrane (the paper's model 2).

The square is inflated in 5 steps; then a cable is laid across its middle, anchored 50 cm beside
it (the paper's drawing is lost; the place is ours), and both ends are pulled down by 15 cm in 5
steps. No mesh line lies under the cable: it folds the cells that it crosses. Units: kgf, cm.

    ./run python demos/inflated_square.py
"""

from mpi4py import MPI

from crms_fenicsx import Cable, IsotropicMembrane, Scene, Solver, meshes

mesh = meshes.rectangle(MPI.COMM_WORLD, width=100.0, depth=100.0, size=4.0, structured=True)
scene = Scene(mesh, IsotropicMembrane(E=300.0, nu=0.25, thickness=0.08))
scene.fix("boundary")
solver = Solver(scene, results="results/inflated_square")

solver.advance(pressure=0.01, steps=5)
solver.draw("results/inflated_square/inflated.png", unit="cm", title="Inflated, 0.01 kgf/cm2")
inflated = scene.energy

cable = scene.lay_cable(Cable(EA=32000.0), path=[(-50.0, 50.0, 0.0), (150.0, 50.0, 0.0)])
solver.advance(move={cable: (0.0, 0.0, -15.0)}, steps=5)
solver.draw("results/inflated_square/tightened.png", unit="cm", title="Cable ends 15 cm lower")
solver.draw_history("results/inflated_square/history.png")

if scene.comm.rank == 0:
    print(f"inflated: energy {inflated:.6g} kgf cm")
    print(f"tightened: tension {cable.tension:.5g} kgf, energy {scene.energy:.6g} kgf cm")
