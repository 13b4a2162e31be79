/* Says on standard error what OpenMM enqueues on an OpenCL device; is loaded in front of the OpenCL library. */
#include <dlfcn.h>
#include <stddef.h>
#include <stdio.h>

#define KERNEL_FUNCTION_NAME 0x1190

static void *original(const char *name) { return dlsym(dlopen("libOpenCL.so.1", RTLD_LAZY), name); }

int clEnqueueNDRangeKernel(void *queue, void *kernel, unsigned dimensions, const size_t *offset, const size_t *global,
                           const size_t *local, unsigned waits, const void *list, void *event) {
    int (*enqueue)(void *, void *, unsigned, const size_t *, const size_t *, const size_t *, unsigned, const void *,
                   void *) = original("clEnqueueNDRangeKernel");
    int (*info)(void *, unsigned, size_t, void *, size_t *) = original("clGetKernelInfo");
    char name[256] = "";
    info(kernel, KERNEL_FUNCTION_NAME, sizeof name, name, NULL);
    fprintf(stderr, "launch %s\n", name);
    return enqueue(queue, kernel, dimensions, offset, global, local, waits, list, event);
}

int clEnqueueWriteBuffer(void *queue, void *buffer, unsigned blocking, size_t offset, size_t size, const void *from,
                         unsigned waits, const void *list, void *event) {
    int (*enqueue)(void *, void *, unsigned, size_t, size_t, const void *, unsigned, const void *, void *) =
        original("clEnqueueWriteBuffer");
    fprintf(stderr, "upload\n");
    return enqueue(queue, buffer, blocking, offset, size, from, waits, list, event);
}

int clEnqueueReadBuffer(void *queue, void *buffer, unsigned blocking, size_t offset, size_t size, void *to,
                        unsigned waits, const void *list, void *event) {
    int (*enqueue)(void *, void *, unsigned, size_t, size_t, void *, unsigned, const void *, void *) =
        original("clEnqueueReadBuffer");
    fprintf(stderr, "read\n");
    return enqueue(queue, buffer, blocking, offset, size, to, waits, list, event);
}
