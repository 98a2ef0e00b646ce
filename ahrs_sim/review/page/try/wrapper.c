/* For the page: an exported estimator, and where all figures of its data sheet lie, in the order of SensorInfo. */
#include "@NAME@.c"

__attribute__((export_name("page_sensors"))) double *page_sensors(void);
double *page_sensors(void) { return (double *)memory_sensors; }
