# docker build -t ahrs_sim . && docker run --rm -v "$PWD/logs:/flights" ahrs_sim fly circuit -o circuit.mcap
FROM python:3.12-slim
COPY . /ahrs_sim
RUN pip install --no-cache-dir "/ahrs_sim[peers,plot,bags,export,campaign]" && useradd --create-home pilot \
    && mkdir /flights && chown pilot /flights
USER pilot
WORKDIR /flights
ENTRYPOINT ["ahrs-sim"]
