/* The exchange of one scan by libmodbus: FC23, 32 registers read and 16 written, again and again on one connection.
 * Usage: exchange HOST PORT COUNT; prints the nanoseconds of each exchange, one per line. */
#include <errno.h>
#include <modbus.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <time.h>

static int64_t now_ns(void)
{
    struct timespec now;
    clock_gettime(CLOCK_MONOTONIC, &now);
    return (int64_t)now.tv_sec * 1000000000 + now.tv_nsec;
}

int main(int argc, char **argv)
{
    if (argc != 4) {
        fprintf(stderr, "usage: exchange HOST PORT COUNT\n");
        return 2;
    }
    modbus_t *link = modbus_new_tcp(argv[1], atoi(argv[2]));
    if (link == NULL || modbus_set_slave(link, 1) == -1 || modbus_connect(link) == -1) {
        fprintf(stderr, "exchange: %s\n", modbus_strerror(errno));
        return 1;
    }
    uint16_t words[16] = {0}, picture[32];
    for (long left = atol(argv[3]); left > 0; left--) {
        words[0]++;
        int64_t began_ns = now_ns();
        if (modbus_write_and_read_registers(link, 0, 16, words, 100, 32, picture) != 32) {
            fprintf(stderr, "exchange: %s\n", modbus_strerror(errno));
            return 1;
        }
        printf("%lld\n", (long long)(now_ns() - began_ns));
    }
    modbus_close(link);
    modbus_free(link);
    return 0;
}
