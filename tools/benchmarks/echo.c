/* A bare echo on the bus: `echo PORT`. Answers each datagram that is not an answer itself. */
#include <arpa/inet.h>
#include <netinet/in.h>
#include <stdlib.h>
#include <sys/socket.h>

int main(int count, char **words)
{
    int bus = socket(AF_INET, SOCK_DGRAM, 0), on = 1;
    unsigned char ttl = 0;
    struct sockaddr_in group = {.sin_family = AF_INET};
    struct in_addr loopback = {.s_addr = htonl(INADDR_LOOPBACK)};
    struct ip_mreq membership = {.imr_interface = loopback};
    char data[512];

    if (count != 2)
        return 2;
    group.sin_port = htons(atoi(words[1]));
    inet_aton("239.74.163.2", &group.sin_addr);
    membership.imr_multiaddr = group.sin_addr;
    setsockopt(bus, SOL_SOCKET, SO_REUSEADDR, &on, sizeof on);
    setsockopt(bus, IPPROTO_IP, IP_MULTICAST_IF, &loopback, sizeof loopback);
    setsockopt(bus, IPPROTO_IP, IP_MULTICAST_TTL, &ttl, sizeof ttl);
    if (bind(bus, (struct sockaddr *)&group, sizeof group) != 0)
        return 1;
    setsockopt(bus, IPPROTO_IP, IP_ADD_MEMBERSHIP, &membership, sizeof membership);
    for (;;) {
        ssize_t size = recv(bus, data + 1, sizeof data - 1, 0);
        if (size <= 0 || data[1] == 'E')
            continue;
        data[0] = 'E';
        sendto(bus, data, size + 1, 0, (struct sockaddr *)&group, sizeof group);
    }
}
