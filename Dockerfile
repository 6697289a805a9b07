# The two commands of README.md in a container, without ROS from apt. Untried: nobody has built it yet.
#   docker build -t geomid_ros . && docker run --rm -it geomid_ros make demo
FROM python:3.12-slim-bookworm
RUN apt-get update && apt-get install --yes --no-install-recommends gcc git libc6-dev libgomp1 libquadmath0 make && rm -rf /var/lib/apt/lists/*
WORKDIR /geomid_ros
COPY . .
RUN make setup
CMD ["make", "demo"]
