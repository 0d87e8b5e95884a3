# The suite as a workspace of ROS 2 Jazzy, by the commands of the README.
#
#   docker build --tag mother_rover .
#   docker run --rm --network host mother_rover ros2 launch mother_rover descent.launch.py
FROM ros:jazzy

SHELL ["/bin/bash", "-c"]
WORKDIR /ws
COPY . src/mother_rover
# The packages that come by pip are those of the README's pip line.
RUN apt-get update \
    && apt-get install --yes --no-install-recommends python3-pip python3-colcon-common-extensions \
    && rosdep update --rosdistro jazzy \
    && rosdep install --from-paths src --ignore-src -y \
    && eval "$(grep --max-count=1 '^pip install ' src/mother_rover/README.md) --no-cache-dir" \
    && rm -rf /var/lib/apt/lists/*
RUN source /opt/ros/jazzy/setup.bash && colcon build

RUN printf '#!/bin/bash\nsource /ws/install/setup.bash\nexec "$@"\n' >/entrypoint \
    && chmod +x /entrypoint
ENTRYPOINT ["/entrypoint"]
CMD ["bash"]
