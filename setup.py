"""What goes into the package: the code, and of each policy in `policies/` what using it takes."""

from setuptools import find_packages, setup

SHIPPED = "arrive.policies.shipped"

setup(
    packages=[*find_packages("src"), SHIPPED],
    package_dir={"": "src", SHIPPED: "policies"},
    package_data={
        "arrive": ["py.typed"],
        "arrive.commands": ["*.json"],
        "arrive.play": ["*.js", "*.css"],
        "arrive.report": ["*.css"],
        SHIPPED: ["*/policy.pt", "*/config.json", "*/difficulty.json", "*/motor.safetensors"],
    },
)
