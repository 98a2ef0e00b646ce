# docker build -t ahrs_sim . && docker run --rm -v "$PWD/logs:/logs" ahrs_sim fly circuit -o /logs/circuit.mcap
FROM python:3.12-slim
COPY . /ahrs_sim
RUN pip install --no-cache-dir "/ahrs_sim[peers,plot,bags,export,campaign]" && useradd --create-home pilot
USER pilot
WORKDIR /home/pilot
ENTRYPOINT ["ahrs-sim"]
