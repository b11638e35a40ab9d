# SPDX-License-Identifier: Apache-2.0
"""Trees of /sys as hosts with a GPU, sensors of power or a battery have them; names and units as in their
kernels, figures as read under load.
"""

from collections.abc import Mapping
from pathlib import Path

# Jetson AGX Orin, JetPack 6: two INA3221, no input rail of the module among them.
AGX_ORIN = {
    "sys/devices/platform/bus@0/17000000.gpu/load": "742",
    "sys/class/thermal/thermal_zone0/type": "cpu-thermal",
    "sys/class/thermal/thermal_zone0/temp": "61343",
    "sys/class/thermal/thermal_zone1/type": "gpu-thermal",
    "sys/class/thermal/thermal_zone1/temp": "58906",
    "sys/class/thermal/thermal_zone8/type": "tj-thermal",
    "sys/class/thermal/thermal_zone8/temp": "61343",
    "sys/class/hwmon/hwmon0/name": "pwmfan",
    "sys/class/hwmon/hwmon3/name": "ina3221",
    "sys/class/hwmon/hwmon3/in1_label": "VDD_GPU_SOC",
    "sys/class/hwmon/hwmon3/in1_input": "19192",
    "sys/class/hwmon/hwmon3/curr1_input": "624",
    "sys/class/hwmon/hwmon3/in2_label": "VDD_CPU_CV",
    "sys/class/hwmon/hwmon3/in2_input": "19184",
    "sys/class/hwmon/hwmon3/curr2_input": "208",
    "sys/class/hwmon/hwmon3/in3_label": "VIN_SYS_5V0",
    "sys/class/hwmon/hwmon3/in3_input": "4992",
    "sys/class/hwmon/hwmon3/curr3_input": "944",
    "sys/class/hwmon/hwmon3/in7_label": "sum of shunt voltages",
    "sys/class/hwmon/hwmon3/in7_input": "3",
}
# Jetson Orin Nano, JetPack 6: one INA3221 whose first channel is the whole module.
ORIN_NANO = {
    "sys/devices/platform/17000000.gpu/load": "0",
    "sys/class/thermal/thermal_zone0/temp": "47125",
    "sys/class/hwmon/hwmon1/name": "ina3221",
    "sys/class/hwmon/hwmon1/in1_label": "VDD_IN",
    "sys/class/hwmon/hwmon1/in1_input": "4928",
    "sys/class/hwmon/hwmon1/curr1_input": "1256",
    "sys/class/hwmon/hwmon1/in2_label": "VDD_CPU_GPU_CV",
    "sys/class/hwmon/hwmon1/in2_input": "4928",
    "sys/class/hwmon/hwmon1/curr2_input": "272",
    "sys/class/hwmon/hwmon1/in3_label": "VDD_SOC",
    "sys/class/hwmon/hwmon1/in3_input": "4936",
    "sys/class/hwmon/hwmon1/curr3_input": "288",
}
_INA_NX = "sys/bus/i2c/drivers/ina3221x/7-0040/iio:device0"
# Jetson Xavier NX, JetPack 4: the driver ina3221x, milliwatts.
XAVIER_NX = {
    "sys/devices/gpu.0/load": "318",
    "sys/class/thermal/thermal_zone0/temp": "44500",
    "sys/class/thermal/thermal_zone4/type": "PMIC-Die",
    "sys/class/thermal/thermal_zone4/temp": "100000",  # it states this, whatever it is
    "sys/bus/i2c/drivers/ina3221x/bind": "",
    f"{_INA_NX}/rail_name_0": "VDD_IN",
    f"{_INA_NX}/in_power0_input": "5287",
    f"{_INA_NX}/rail_name_1": "VDD_CPU_GPU_CV",
    f"{_INA_NX}/in_power1_input": "1208",
    f"{_INA_NX}/rail_name_2": "VDD_SOC",
    f"{_INA_NX}/in_power2_input": "1168",
}
# A NUC on the battery of its robot, and a mouse beside it.
ROBOT_NUC = {
    "sys/class/power_supply/AC/type": "Mains",
    "sys/class/power_supply/AC/online": "0",
    "sys/class/power_supply/BAT0/type": "Battery",
    "sys/class/power_supply/BAT0/status": "Discharging",
    "sys/class/power_supply/BAT0/capacity": "37",
    "sys/class/power_supply/BAT0/voltage_now": "24110000",
    "sys/class/power_supply/BAT0/current_now": "-1750000",
    "sys/class/power_supply/hid-mouse/type": "Battery",
    "sys/class/power_supply/hid-mouse/scope": "Device",
    "sys/class/power_supply/hid-mouse/capacity": "4",
}
# A workstation of two packages, each with a part of its own, and the counter of the platform.
WORKSTATION = {
    "sys/class/powercap/intel-rapl/enabled": "1",
    "sys/class/powercap/intel-rapl:0/name": "package-0",
    "sys/class/powercap/intel-rapl:0/energy_uj": "262140000000",
    "sys/class/powercap/intel-rapl:0/max_energy_range_uj": "262143328850",
    "sys/class/powercap/intel-rapl:0:0/name": "core",
    "sys/class/powercap/intel-rapl:0:0/energy_uj": "90000000000",
    "sys/class/powercap/intel-rapl:1/name": "package-1",
    "sys/class/powercap/intel-rapl:1/energy_uj": "1000000",
    "sys/class/powercap/intel-rapl:1/max_energy_range_uj": "262143328850",
    "sys/class/powercap/intel-rapl:2/name": "psys",
    "sys/class/powercap/intel-rapl:2/energy_uj": "5000000",
}


def make_tree(root: Path, files: Mapping[str, str]) -> str:
    """Write the files below ``root``; its path, as the readers take it."""
    for name, text in files.items():
        path = root / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(f"{text}\n")
    return str(root)
