"""Three jumps of the spatial plant, side by side."""

from rover_sim import JumpMotorCommand, PlantCommand, build_plant, load_scenario, roll_out

plant = build_plant(load_scenario("floor_rubble"))
jumps = [PlantCommand(jump=JumpMotorCommand(stroke, rate=0.05)) for stroke in (0.10, 0.15, 0.20)]
for flown in roll_out(plant, [plant.initial_state()], jumps, duration=12.0):
    print(f"{flown.event('apex').values['height']:.2f} m")
