/* Start-up code and C functions for a Windows library that is linked to the system's C library only, without MinGW.
 *
 * MinGW's start-up code would be three quarters of the library. MinGW also has its own exp, while Python on Windows uses the
 * system's: results would differ in the last bit. A C compiler on Windows needs none of this, so this file is not among an
 * FMU's sources: only vpp_fmu.export compiles it. */

#include <stdarg.h>
#include <stddef.h>

int _fltused = 1; /* compilers refer to it wherever there are floats */

/* The library's entry: nothing to set up. */
int __stdcall DllMainCRTStartup(void *library, unsigned reason, void *reserved) {
  (void)library, (void)reason, (void)reserved;
  return 1;
}

int __stdio_common_vsprintf(unsigned long long options, char *text, size_t size, const char *format, void *locale, va_list);

int vsnprintf(char *text, size_t size, const char *format, va_list values) {
  return __stdio_common_vsprintf(2, text, size, format, NULL, values); /* 2: behave as the C standard says */
}

int snprintf(char *text, size_t size, const char *format, ...) {
  va_list values;
  va_start(values, format);
  const int written = vsnprintf(text, size, format, values);
  va_end(values);
  return written;
}

/* Touches each page of a stack frame of several pages (its size is in rax): the stack grows by one page at a time. */
__asm__(".globl ___chkstk_ms\n"
        "___chkstk_ms:\n"
        "  pushq %rcx\n"
        "  pushq %rax\n"
        "  leaq 24(%rsp), %rcx\n"
        "1:cmpq $0x1000, %rax\n"
        "  jb 2f\n"
        "  subq $0x1000, %rcx\n"
        "  orq $0, (%rcx)\n"
        "  subq $0x1000, %rax\n"
        "  jmp 1b\n"
        "2:subq %rax, %rcx\n"
        "  orq $0, (%rcx)\n"
        "  popq %rax\n"
        "  popq %rcx\n"
        "  ret\n");
