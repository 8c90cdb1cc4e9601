# docker build -t crms_fenicsx . && docker run --rm -v "$PWD:/root/shared" crms_fenicsx \
#     python3 demos/inflated_square.py
FROM dolfinx/dolfinx:v0.9.0
# WeasyPrint, for reports as PDF, needs Pango
RUN apt-get update && apt-get install -y --no-install-recommends libpangoft2-1.0-0 \
    libharfbuzz-subset0 && rm -rf /var/lib/apt/lists/*
COPY . /opt/crms_fenicsx
RUN pip install --no-cache-dir --upgrade "setuptools>=77" && \
    pip install --no-cache-dir --no-build-isolation "/opt/crms_fenicsx[test]"
WORKDIR /root/shared
