"""Lowers the rover into the pit of shallow_pit.yaml and prints the result."""

from pathlib import Path

from rover_sim import PlantCommand, WinchCommand, build_plant, load_scenario, run

PIT = Path(__file__).parent / "shallow_pit.yaml"

plant = build_plant(load_scenario(PIT))
lower = PlantCommand(winch=WinchCommand(length=7.5, rate=0.2))
down = run(plant, plant.initial_state(), 25.0, command=lower, until="touchdown")
landed = down.event("touchdown")
print(f"{landed.name} after {landed.time:.1f} s with {down.final.length:.2f} m of tether")
print(f"peak tension {down.peak_tension:.1f} N, energy drift {down.energy_drift:.1e} J")
